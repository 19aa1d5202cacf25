"""Vision: board detection, sub-pixel corners, triangulation and board poses.

Other packages use only the names exported here.
"""

from mobilecal_cli.vision.agreement import (
    agreeing,
    check_arrangement,
    check_square,
    square_cure,
    square_error,
)
from mobilecal_cli.vision.detection import SizeVote, detect, find_board, identify_size
from mobilecal_cli.vision.following import BoardFollower
from mobilecal_cli.vision.grid import resolve_numbering
from mobilecal_cli.vision.markers import readable_words
from mobilecal_cli.vision.observing import Measured, measure, resolve_square
from mobilecal_cli.vision.values import Detection, Miss
