"""The paper's experiments and more as data: ids with settings, a runner, tables and figures (``oee reproduce``)."""

from oee_tabular.experiments.common import Embedded, embedded_default

__all__ = ["Embedded", "embedded_default"]
