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

__all__ = ["DIGEST", "KIND", "csv_bytes", "digest", "read_npz", "save_npz", "write_all"]
