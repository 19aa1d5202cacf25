"""Containers: bytes, channels and log times of recorded files."""
