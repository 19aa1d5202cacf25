"""The likelihood of all measurements: residuals, derivatives, information (method.md)."""
