"""Writers and readers of params.yaml, extraction.npz and other formats, and of output directories."""
