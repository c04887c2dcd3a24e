"""``python -m oee_tabular`` is the command ``oee``."""

from oee_tabular.cli import main

if __name__ == "__main__":
    main()
