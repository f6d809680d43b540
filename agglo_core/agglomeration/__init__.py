"""From a mesh or graph to a hierarchy: components at work, level by level, until every target is met."""

from agglo_core.agglomeration.pipeline import Choice, Pipeline, agglomerate

__all__ = ["Choice", "Pipeline", "agglomerate"]
