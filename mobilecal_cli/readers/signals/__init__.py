"""Signals: joints, wheels and image times of a recording."""
