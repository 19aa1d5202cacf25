"""The likelihood of everything that was measured: residuals, derivatives, information (method.md)."""
