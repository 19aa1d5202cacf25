"""Write docs/validation/refusals.md from the cases that the tests run."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.hostile.refusals import table  # noqa: E402

if __name__ == "__main__":
    (ROOT / "docs/validation/refusals.md").write_text(table(), encoding="utf-8")
