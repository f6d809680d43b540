"""Bisectors by k-means: a deterministic one in batches, and the paper's by scikit-learn."""

from __future__ import annotations

from agglo_core.authoring import Component, hookimpl


@hookimpl
def agglo_components() -> list[Component]:
    """Return this plugin's components, the bisectors ``kmeans`` and ``kmeans_sklearn``."""
    return [
        Component(
            kind="bisector",
            name="kmeans",
            target="agglo_kmeans.kmeans:KMeans",
            promises={
                "deterministic": True,
                "invariant": True,
                "kway": True,
                "3d": True,
                "pickles": True,
            },
            summary="Batched deterministic 2-means from up to eight axes; k-way by Lloyd steps.",
        ),
        Component(
            kind="bisector",
            name="kmeans_sklearn",
            target="agglo_kmeans.sklearn_kmeans:SklearnKMeans",
            requires=("sklearn",),
            promises={"3d": True, "pickles": True},
            summary="The paper's bisector: scikit-learn 2-means, k-means++ and 10 restarts.",
        ),
    ]
