"""Files as the package writes them, for tests of files that a person, or a disk, has
changed.
"""

from oee_tabular._files import (
    DIGEST,
    KIND,
    csv_bytes,
    digest,
    read_npz,
    save_npz,
    write_all,
)
from oee_tabular._writing import Part, folder_part, waiting_interrupts

__all__ = [
    "DIGEST",
    "KIND",
    "Part",
    "csv_bytes",
    "digest",
    "folder_part",
    "read_npz",
    "save_npz",
    "waiting_interrupts",
    "write_all",
]
