"""The data types that the stages exchange: frozen dataclasses with checked shapes and read-only arrays."""
