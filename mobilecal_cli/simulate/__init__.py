"""Robots with known truth: their drives, and recordings of them in every container."""
