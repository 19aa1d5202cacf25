"""Files and processes that outlive nothing: reading within limits, temporary files, placing, signals."""
