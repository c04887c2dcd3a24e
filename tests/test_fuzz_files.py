"""A short run of ``fuzz_files.py``: files that are broken in every way that it knows."""

import fuzz_files
import pytest


@pytest.mark.filterwarnings("ignore")
def test_broken_files_are_refused_with_a_sentence(tmp_path):
    number, outcomes, failures = fuzz_files.fuzz(seed=1, seconds=10, folder=tmp_path)
    assert not [one for one in failures if "death" in str(one) or "hang" in str(one)]
    assert number > 100
    assert outcomes["refused"] > outcomes["finite"] > 0
