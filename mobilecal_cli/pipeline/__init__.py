"""The stages of a calibration joined into commands, one module a command; `steps` is the Python interface."""
