"""From a mesh or graph to a hierarchy: a run of chosen components, until every goal is met."""

from agglo_core.agglomeration.choices import Choice
from agglo_core.agglomeration.one_call import agglomerate
from agglo_core.agglomeration.pipeline import Pipeline

__all__ = ["Choice", "Pipeline", "agglomerate"]
