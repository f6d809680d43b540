"""Built-in components, declared to the registry in the same way as those of plugins."""

from __future__ import annotations

from agglo_core.registry import Component, hookimpl

_METRICS = {
    "UF": ("UniformityFactor", "Diameter over the largest diameter (paper, §4)."),
    "UF99": ("UniformityFactor99", "Diameter over the 99th percentile of diameters; may exceed 1."),
    "CR": ("CircleRatio", "Radius of the largest circle (ball) inside over half the diameter (paper, §4)."),
    "CRc": ("CentredCircleRatio", "The same with the circle (ball) centred at the centroid."),
    "diameter_ratio": ("DiameterRatio", "Diameter over a target h*."),
    "interface_length": ("InterfaceLength", "Measure of the faces shared with other agglomerates."),
    "cut": ("Cut", "Number of dual edges that leave (paper, §2.1)."),
    "ncut": ("NormalisedCut", "Cut over volume (paper, §2.1)."),
    "components": ("Components", "Number of connected components."),
    "cells": ("Cells", "Number of cells."),
}
_ROUND = {
    "J": ("InertiaRatio", "Moment of inertia of a disc (ball) of that size over its own."),
    "isoperimetric": ("IsoperimetricQuotient", "4π area over perimeter squared; 36π volume² over surface³."),
}
_SHAPES = {
    "convexity": ("Convexity", "Area (volume) over that of the convex hull."),
    "star_shapedness": (
        "StarShapedness",
        "Area (volume) of the kernel (the points that see the whole) over its own.",
    ),
    "box_ratio": ("BoxRatio", "Short over long side of the narrowest rectangle (box) around it."),
    "edge_ratio": ("EdgeRatio", "Shortest over longest straight edge of the boundary."),
    "face_ratio": ("FaceRatio", "Smallest over largest flat face of the boundary; in 2-D of its edges."),
}
_MESHLANE_SUFFIXES = (
    ".avs .bdf .cdb .cgns .dat .dato .e .ex2 .exo .f3grid .fem .h5m .hmf .inp .mdpa .med .mesh .meshb "
    ".msh .nas .post .stl .su2 .tec .ugrid .vol .vtk .wkt .xdmf .xmf .xml"
)
_FORMATS = {
    "vtu": ("vtk.vtu:Vtu", ".vtu", "ParaView's .vtu: any mesh, its tags, the labels of all levels."),
    "npz": (
        "npz:Npz",
        ".npz",
        "numpy's .npz: everything a mesh and its hierarchy hold, losslessly.",
    ),
    "fvca": (
        "text.fvca:Fvca",
        ".typ2 .typ1",
        "FVCA's .typ2 and .typ1 (only read): polygons, as HArDCore2D and DISK++ read them.",
    ),
    "matlab": (
        "matlab.format:Matlab",
        ".mat",
        "MATLAB's .mat: polygons and polyhedra in the variables of lymph, mVEM, PolyMesher and MRST.",
    ),
    "rf": (
        "text.regn_face:RegnFace",
        ".ele .node",
        "HArDCore3D's .node and .ele: polyhedra by their faces (REGN_FACE).",
    ),
    "hedra": ("text.hedra:Hedra", ".hedra", "cinolib's .hedra: polyhedra with faces of their own."),
    "ovm": ("text.ovm:Ovm", ".ovm", "OpenVolumeMesh's .ovm as text: polyhedra of half-faces."),
    "off": ("text.off_obj:Off", ".off", "OFF: plane polygons, as cinolib and others write them."),
    "obj": ("text.off_obj:Obj", ".obj", "Wavefront OBJ: plane polygons."),
    "ply": ("text.ply:Ply", ".ply", "PLY: plane polygons, as text or binary."),
    "meshlane": (
        "foreign.meshlane:Meshlane",
        _MESHLANE_SUFFIXES,
        "Gmsh, legacy VTK and more: triangles, quadrilaterals and 3-D elements, written only without loss.",
    ),
    "openfoam": (
        "openfoam.format:OpenFoam",
        ".foam .openfoam",
        "OpenFOAM cases, by way of the .foam file that marks them: polyhedra.",
    ),
    "vtkhdf": (
        "vtk.vtkhdf:VtkHdf",
        ".vtkhdf",
        "VTKHDF, ParaView's grids in HDF5: any mesh; needs h5py (agglo[hdf]).",
    ),
    "pvtu": ("vtk.pvtu:Pvtu", ".pvtu", "Parallel .pvtu: the .vtu files that it names as one mesh."),
    "vtp": ("vtk.vtu:Vtp", ".vtp", "ParaView's .vtp: plane polygons of PolyData."),
}
_MAGIC = {
    "vtu": r"(?s)\A(?=.*<VTKFile)(?=.*UnstructuredGrid)(?!.*PUnstructuredGrid)",
    "pvtu": r"(?s)\A(?=.*<VTKFile)(?=.*PUnstructuredGrid)",
    "vtp": r"(?s)\A(?=.*<VTKFile)(?=.*\"PolyData\")",
    "npz": r"(?s)\APK\x03\x04.*\.npy",
    "fvca": r"(?i)\A\s*vertices",
    "matlab": r"\AMATLAB 5\.0 MAT-file",
    "ovm": r"\A\s*OVM\s+ASCII(?:\s|\Z)",
    "off": r"\A\s*(?:ST)?C?N?OFF\s",
    "ply": r"\Aply\r?\n",
    "openfoam": r"(?s)FoamFile|\A/\*.*OpenFOAM",
}
_NEEDED_BY_FORMATS = {"meshlane": ("meshlane",), "vtkhdf": ("h5py",)}
_SOLID_FORMATS = ("vtu", "npz", "vtkhdf", "pvtu", "matlab", "openfoam", "rf", "hedra", "ovm")
_SAMPLES = {
    "triangles": "Unit square of n × n squares, each cut in two triangles.",
    "squares": "Unit square of n × n squares.",
    "random_triangles": "Delaunay triangles of n random points in the unit square (about 2n cells).",
    "voronoi": "Voronoi cells of n random points in the unit square.",
    "hexagons": "n rows of n regular hexagons.",
    "ring": "Annulus with n quadrilaterals around it, about n²/9 in all.",
    "strip": "n squares in a row.",
    "disconnected": "Two unit squares apart, each of n × n squares.",
    "boxes": "Unit cube of n × n × n cubes.",
    "tetrahedra": "Unit cube of n × n × n cubes, each cut in six tetrahedra.",
    "random_tetrahedra": "Delaunay tetrahedra of up to n random points, evenly spread, in the unit cube.",
    "voronoi3d": "Voronoi cells of n random points in the unit cube.",
    "prisms": "Delaunay triangles of n random points, extruded to layers in the unit cube.",
    "layered": "Layers of rock, tilted and folded, with two faults (about n³/2 hexahedra).",
    "paper": "The paper's fine grids: triangles, squares, random or voronoi.",
    "brain": "Section of a human brain: 13,978 triangles.",
    "brain_holes": "The same section with five holes: 13,327 triangles.",
    "brain3d": "Human brain in cubes of so many millimetres, with its tissues.",
}
_SOLID_SAMPLES = ("boxes", "tetrahedra", "random_tetrahedra", "voronoi3d", "prisms", "layered", "brain3d")
_PROBLEMS = {
    "diffusion": ("diffusion:Diffusion", "−∇·(κ∇u) = f; data by cell tag and boundary tag in a file."),
    "elasticity": (
        "elasticity:Elasticity",
        "Linear elasticity; data by cell tag and boundary tag in a file.",
    ),
    "linear": ("linear:Linear", "A x = b from files, with unknowns in the cells of the mesh."),
    "constant": ("diffusion:constant", "−Δu = 8 with u = 0 on the boundary (the paper's published counts)."),
    "sine": ("diffusion:sine", "f = 2π² sin πx sin πy with u = 0 on the boundary (the paper's text)."),
}

_ESTIMATORS = {
    "residual": ("Residual", "Residuals in the cells, and jumps of fluxes and values on faces."),
    "gradient_jump": ("GradientJump", "Jumps of fluxes and values on faces alone."),
}
_SMOOTHERS = {
    "block_jacobi": ("smoothers.level_smoothers:BlockJacobi", "Block Jacobi steps, damped by 4/(3 λ_max)."),
    "gauss_seidel": (
        "smoothers.level_smoothers:GaussSeidel",
        "Block Gauss–Seidel: forward sweeps, then as many backward.",
    ),
    "chebyshev": (
        "smoothers.level_smoothers:Chebyshev",
        "Chebyshev polynomials of the matrix, preconditioned by its diagonal blocks.",
    ),
    "vertex_patches": (
        "smoothers.patch_smoother:PatchSmoother",
        "Multiplicative Schwarz on the patches of a level: linear and symmetric.",
    ),
}
_MULTIGRID = {
    ("transfer", "injection"): (
        "coarsening.transfers:Injection",
        "The functions of the coarse space as they are, or their L2 projections.",
    ),
    ("transfer", "smoothed"): (
        "coarsening.transfers:SmoothedInjection",
        "Injection after a damped step of block Jacobi.",
    ),
    ("transfer", "aggregation"): (
        "coarsening.transfers:Aggregation",
        "Smoothed aggregation: near-null vectors on the agglomerates.",
    ),
    ("coarse_operator", "galerkin"): ("coarse_operators:Galerkin", "Pᵀ A P."),
    ("coarse_operator", "rediscretised"): (
        "coarse_operators:Rediscretised",
        "The problem discretised on the agglomerates.",
    ),
    ("coarse_solver", "elimination"): (
        "coarse_solve:Elimination",
        "An inverse for up to 1,500 unknowns, then a sparse factorisation; singular matrices too.",
    ),
    ("coarse_solver", "dense"): ("coarse_solve:Dense", "A dense inverse, or pseudo-inverse."),
    ("coarse_solver", "lu"): ("coarse_solve:SparseLU", "Sparse LU factors of SuperLU."),
}

_CONSTRAINTS = {
    "regions": ("regions:Regions", "No part holds cells of two regions: of different values of cell tags."),
    "where": ("regions:Where", "Only cells with a tag are agglomerated, all others stay single."),
    "barriers": ("barriers:BarrierTags", "No part lies on both sides of faces with a tag: fractures, walls."),
    "ridges": ("ridges:Ridges", "Cells join only those on the same boundary patches, at corners none."),
    "bounds": (
        "bounds:Bounds",
        "At most, and where possible at least, so many cells, so much measure or weight.",
    ),
}


@hookimpl
def agglo_components() -> list[Component]:
    """Return all built-in component declarations."""
    own = (_refiners, _bisectors, _constraints, _metrics, _formats, _samples, _problems)
    parts = (*own, _estimators, _smoothers, _multigrid, _solvers, _sections)
    return [component for each in parts for component in each()]


def _refiners() -> list[Component]:
    alike = {"deterministic": True, "3d": True, "pickles": True}
    return [
        Component(
            kind="refiner",
            name="interface",
            target="agglo_core.refine.interface:InterfaceRefiner",
            promises=alike | {"invariant": True},
            summary="Moves boundary cells to shorten the interface.",
        ),
        Component(
            kind="refiner",
            name="compactness",
            target="agglo_core.refine.compactness.refiner:CompactnessRefiner",
            promises=alike | {"invariant": True},
            summary="Moves boundary cells for compact parts with short interfaces, many parts at once.",
        ),
        Component(
            kind="refiner",
            name="fm",
            target="agglo_core.refine.fm:FMRefiner",
            promises=alike,
            summary="Moves chains of boundary cells for short interfaces at given balance (subdomains).",
        ),
        Component(
            kind="refiner",
            name="balance",
            target="agglo_core.refine.balance:BalanceRefiner",
            promises=alike,
            summary="Hands cells on between parts until their sizes are even, within a tolerance or exactly.",
        ),
        Component(
            kind="refiner",
            name="descent",
            target="agglo_core.refine.descent:DescentRefiner",
            promises=alike,
            summary="Moves boundary cells to improve an objective or a metric of your choice.",
        ),
        Component(
            kind="refiner",
            name="anneal",
            target="agglo_core.anneal.refiner:AnnealRefiner",
            promises={"3d": True, "pickles": True},
            summary="Anneals the parts of each block to be round and alike in width.",
        ),
        Component(
            kind="fixer",
            name="connectivity",
            target="agglo_core.refine.connectivity:ConnectivityFixer",
            promises=alike | {"invariant": True},
            summary="Loose components join the neighbour with which they share the most interface.",
        ),
    ]


def _bisectors() -> list[Component]:
    alike = {"deterministic": True, "3d": True, "pickles": True}
    return [
        Component(
            kind="bisector",
            name="coordinate",
            target="agglo_core.split.geometric:CoordinateBisection",
            promises=alike | {"balanced": True},
            summary="Halves by measure across the longest extent along x, y (or z).",
        ),
        Component(
            kind="bisector",
            name="inertial",
            target="agglo_core.split.geometric:InertialBisection",
            promises=alike | {"balanced": True, "invariant": True},
            summary="Halves by measure across the principal axis.",
        ),
        Component(
            kind="bisector",
            name="sweep",
            target="agglo_core.split.straight_cuts:SweepBisection",
            promises=alike | {"invariant": True},
            summary="The best straight cut along eight rotated principal axes: short and compact.",
        ),
    ]


def _metrics() -> list[Component]:
    targets = {name: (f"metrics:{target}", summary) for name, (target, summary) in _METRICS.items()}
    targets |= {name: (f"round_shapes:{target}", summary) for name, (target, summary) in _ROUND.items()}
    targets |= {name: (f"shape_metrics:{target}", summary) for name, (target, summary) in _SHAPES.items()}
    return [
        Component(
            kind="metric",
            name=name,
            target=f"agglo_core.shapes.{target}",
            promises={"deterministic": True, "pickles": True}
            | ({} if name == "edge_ratio" else {"3d": True}),
            summary=summary,
        )
        for name, (target, summary) in targets.items()
    ]


def _formats() -> list[Component]:
    return [
        Component(
            kind="format",
            name=name,
            target=f"agglo_core.io.{target}",
            requires=_NEEDED_BY_FORMATS.get(name, ()),
            promises={"pickles": True} | ({"3d": True} if name in _SOLID_FORMATS else {}),
            summary=summary,
            suffixes=tuple(suffixes.split()),
            magic=_MAGIC.get(name, ""),
        )
        for name, (target, suffixes, summary) in _FORMATS.items()
    ]


def _samples() -> list[Component]:
    return [
        Component(
            kind="sample",
            name=name,
            target=f"agglo_core.samples:{name}",
            promises={"3d": True} if name in _SOLID_SAMPLES else {},
            summary=summary,
        )
        for name, summary in _SAMPLES.items()
    ]


def _problems() -> list[Component]:
    return [
        Component(
            kind="problem",
            name=name,
            target=f"agglo_core.problems.{target}",
            promises={"pickles": True},
            summary=summary,
        )
        for name, (target, summary) in _PROBLEMS.items()
    ]


def _estimators() -> list[Component]:
    return [
        Component(
            kind="estimator",
            name=name,
            target=f"agglo_core.adaptivity.estimators:{target}",
            promises={"deterministic": True, "3d": True, "pickles": True},
            summary=summary,
        )
        for name, (target, summary) in _ESTIMATORS.items()
    ]


def _smoothers() -> list[Component]:
    return [
        Component(
            kind="smoother",
            name=name,
            target=f"agglo_core.multigrid.{target}",
            promises={"deterministic": True, "pickles": True, "symmetric": True},
            summary=summary,
        )
        for name, (target, summary) in _SMOOTHERS.items()
    ]


def _multigrid() -> list[Component]:
    alike = {"deterministic": True, "pickles": True}
    return [
        Component(
            kind=kind,
            name=name,
            target=f"agglo_core.multigrid.{target}",
            promises=alike | ({"symmetric": True} if kind == "coarse_solver" else {}),
            summary=summary,
        )
        for (kind, name), (target, summary) in _MULTIGRID.items()
    ]


def _solvers() -> list[Component]:
    return [
        Component(
            kind="solver",
            name="direct",
            target="agglo_core.solvers.direct:Direct",
            promises={"deterministic": True, "3d": True, "pickles": True, "symmetric": True},
            summary="PolyDG by a sparse direct solver: PARDISO, CHOLMOD or SuperLU.",
        )
    ]


def _constraints() -> list[Component]:
    return [
        Component(
            kind="constraint",
            name=name,
            target=f"agglo_core.constraints.{target}",
            promises={"pickles": True, "3d": True},
            summary=summary,
        )
        for name, (target, summary) in _CONSTRAINTS.items()
    ]


def _sections() -> list[Component]:
    return [
        Component(
            kind="section",
            name="pareto",
            target="agglo_core.draw.webpage.pareto_section:ParetoSection",
            promises={"pickles": True},
            summary="Roundness, evenness and seconds of several runs, and the Pareto front.",
        )
    ]
