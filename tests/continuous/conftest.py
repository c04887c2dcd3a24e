"""What tests of the command on continuous tasks share."""

import shlex
import warnings

import pytest

from oee_tabular.cli import main


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """``oee`` with words, in strings, in a folder of its own: stdout, or stderr where an error is expected."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)

    def run(*words, code=0):
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            with pytest.raises(SystemExit) as ended:
                main(shlex.split(" ".join(str(word) for word in words)))
        captured = capsys.readouterr()
        assert (ended.value.code or 0) == code, captured.err
        return captured.out if code == 0 else captured.err

    return run
