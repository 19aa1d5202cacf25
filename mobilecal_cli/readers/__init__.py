"""Readers: one module per container format, and the data that other stages need from a recording.

`open_recording` detects the format from the contents, never from the suffix. `read_description` reads what describes
the robot, `read_signals` reads everything except image contents in one pass, and `read_images` streams selected
images.
"""

from mobilecal_cli.readers.containers import join_splits, looks_recorded, open_recording, sha256_of
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import Extent
from mobilecal_cli.readers.description import number_fields, read_description
from mobilecal_cli.readers.pictures import pictures_near, read_images
from mobilecal_cli.readers.signals import clocks_that_differ, read_signals
from mobilecal_cli.readers.signals.joints import choose_topics, joint_numbers, never_changing, pose_numbers
