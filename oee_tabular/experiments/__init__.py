"""Settings of the paper's experiments as data."""

from oee_tabular.experiments.embedded import Embedded, embedded_default

__all__ = ["Embedded", "embedded_default"]
