"""Screenshots of reports in Chromium: `python docs/generate/screenshots.py` writes docs/images/.

One report for each verdict, from the sample recordings.
"""

from __future__ import annotations

import base64
import subprocess
import sys
import tempfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY))
from tests.report.browser import Browser  # noqa: E402

IMAGES = REPOSITORY / "docs" / "images"
SAMPLES = REPOSITORY / "sample_logs"
#: Name of the image → recording, further options, and exit code.
REPORTS = {
    "report-pass": ("paper_robot.mcap", (), 0),
    "report-not-enough": ("straight.mcap", (), 6),
    "report-fail": (
        "tick_robot.mcap",
        (
            "--config",
            "tick_robot.rig.yaml",
            "--set",
            "wheels.left.ticks_per_revolution=2048",
            "--set",
            "wheels.right.ticks_per_revolution=2048",
        ),
        6,
    ),
}


def save(browser: Browser, name: str) -> None:
    """Save what the browser shows."""
    data = browser.call("Page.captureScreenshot")["data"]
    (IMAGES / f"{name}.png").write_bytes(base64.b64decode(data))


def main() -> None:
    """Calibrate, open each report, and save a screenshot."""
    IMAGES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, Browser() as browser:
        for name, (log, options, code) in REPORTS.items():
            out = Path(folder) / name
            command = [
                sys.executable,
                "-m",
                "mobilecal_cli",
                "calibrate",
                log,
                "-o",
                str(out),
                *options,
            ]
            done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=SAMPLES)
            assert done.returncode == code, done.stderr
            browser.open(out / "report.html", width=900, height=1100)
            save(browser, name)
            if name == "report-pass":
                browser.open(out / "report.html", width=390, height=844, dark=True)
                save(browser, "report-phone-dark")
            print(f"{name}: {done.stderr.splitlines()[:1]}")


if __name__ == "__main__":
    main()
