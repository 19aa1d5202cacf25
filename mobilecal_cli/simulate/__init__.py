"""Simulated robots with known ground truth: routes, and recordings in every container."""
