"""Adaptive agglomeration: coarse meshes refined where an estimator locates the error."""

from agglo_core.adaptivity.loop import Adaptation, AdaptationStep, adapt

__all__ = ["Adaptation", "AdaptationStep", "adapt"]
