"""The record is equal to itself, and sees what differs."""

import numpy as np
import record


def test_record_equals_itself_and_sees_changes(tmp_path):
    results = record.Record()
    record.record_mdps(results, tmp_path)
    record.record_errors(results)
    np.savez(tmp_path / "a.npz", **results.entries)
    assert record.main(["compare", str(tmp_path / "a.npz"), str(tmp_path / "a.npz")]) == 0
    for key in ("value|FiniteMDP named", "error|20|initial"):
        entry = results.entries[key]
        spoilt = entry + 1e-9 if entry.dtype.kind == "f" else np.array("KeyError: 3")
        np.savez(tmp_path / "b.npz", **results.entries | {key: spoilt})
        _, lines = record.compare(tmp_path / "a.npz", tmp_path / "b.npz")
        assert [line.split(" ")[0] for line in lines["failure"]] == [key.split(" ")[0]]
