"""Readers: one module a container, and what the other stages need out of a recording.

`open_recording` looks at the content, never at the suffix. `read_prelude` tells what there is, `read_signals` reads
everything but the pictures' contents in one pass, `read_images` streams the pictures that are asked for.
"""

from mobilecal_cli.readers.hashing import sha256_of
from mobilecal_cli.readers.images import decode_image, pictures_near, read_images
from mobilecal_cli.readers.indexed import Pictures, find_pictures, read_stamps
from mobilecal_cli.readers.opening import join_parts, open_recording, recognised
from mobilecal_cli.readers.prelude import read_prelude
from mobilecal_cli.readers.recording import Message, Recording
from mobilecal_cli.readers.signals import read_signals
from mobilecal_cli.readers.storage import Extent

__all__ = [
    "Extent",
    "Message",
    "Pictures",
    "Recording",
    "decode_image",
    "find_pictures",
    "join_parts",
    "open_recording",
    "pictures_near",
    "read_images",
    "read_prelude",
    "read_signals",
    "read_stamps",
    "recognised",
    "sha256_of",
]
