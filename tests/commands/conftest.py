"""What several tests of commands share."""

import pytest


@pytest.fixture
def few(monkeypatch):
    """Few images are looked at: enough where the board does not matter."""
    monkeypatch.setattr("mobilecal_cli.calibrate.sample.PICTURE_MOMENTS", 2)
