"""Studies of accuracy and speed."""

import os

# One thread a process, as the studies run one process on each core. It counts only before numpy is loaded.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
