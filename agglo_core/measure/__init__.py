"""Quality of partitions: values per agglomerate, a summary per level, and comparison of runs."""

from agglo_core.measure.agglomerates import Level, measure_levels, quality, summary
from agglo_core.measure.comparison import RunResult, timed_run, wanted
from agglo_core.measure.quality_values import Quality

__all__ = ["Level", "Quality", "RunResult", "measure_levels", "quality", "summary", "timed_run", "wanted"]
