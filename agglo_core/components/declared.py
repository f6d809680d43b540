"""What is declared alike, by kind: name to target and summary."""

from __future__ import annotations

__all__ = [
    "CONSTRAINTS",
    "FORMATS",
    "METRICS",
    "MULTIGRID",
    "NEEDED_BY_FORMATS",
    "PROBLEMS",
    "ROUND",
    "SAMPLES",
    "SHAPES",
    "SMOOTHERS",
    "SOLID_FORMATS",
    "SOLID_SAMPLES",
]

METRICS = {
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
ROUND = {
    "J": ("InertiaRatio", "Moment of inertia of a disc (ball) of that size over its own."),
    "isoperimetric": ("IsoperimetricQuotient", "4π area over perimeter squared; 36π volume² over surface³."),
}
SHAPES = {
    "convexity": ("Convexity", "Area (volume) over that of the convex hull."),
    "star_shapedness": (
        "StarShapedness",
        "Area (volume) of the kernel (the points that see the whole) over its own.",
    ),
    "box_ratio": ("BoxRatio", "Short over long side of the narrowest rectangle (box) around it."),
    "edge_ratio": ("EdgeRatio", "Shortest over longest straight edge of the boundary."),
    "face_ratio": ("FaceRatio", "Smallest over largest flat face of the boundary; in 2-D of its edges."),
}
FORMATS = {
    "vtu": ("vtu_format:Vtu", "ParaView's .vtu: any mesh, its tags, the labels of all levels."),
    "npz": ("npz_format:Npz", "numpy's .npz: everything a mesh and its hierarchy hold, losslessly."),
    "fvca": ("plain_formats:Fvca", "FVCA's .typ1 and .typ2, as HArDCore2D and DISK++ read them."),
    "matlab": ("matlab_format:Matlab", "MATLAB's .mat: the variables of lymph, mVEM and PolyMesher."),
    "rf": ("plain_formats:RegnFace", "HArDCore3D's .node and .ele: polyhedra by their faces (REGN_FACE)."),
    "hedra": ("plain_formats:Hedra", "cinolib's .hedra: polyhedra with faces of their own."),
    "ovm": ("plain_formats:Ovm", "OpenVolumeMesh's .ovm as text: polyhedra of half-faces."),
    "off": ("plain_formats:Off", "OFF: plane polygons, as cinolib and others write them."),
    "obj": ("plain_formats:Obj", "Wavefront OBJ: plane polygons."),
    "ply": ("plain_formats:Ply", "PLY: plane polygons, as text or binary."),
    "meshlane": ("meshlane_format:Meshlane", "Gmsh, legacy VTK and more, where no other format reads them."),
    "openfoam": ("foam_format:OpenFoam", "OpenFOAM cases, by way of the .foam file that marks them."),
    "vtkhdf": ("vtkhdf_format:VtkHdf", "VTKHDF, ParaView's grids in HDF5; needs h5py (agglo[hdf])."),
    "pvtu": ("plain_formats:Pvtu", "Parallel .pvtu: the .vtu files that it names as one mesh."),
    "vtp": ("plain_formats:Vtp", "ParaView's .vtp: plane polygons of PolyData."),
}
NEEDED_BY_FORMATS = {"meshlane": ("meshlane",), "vtkhdf": ("h5py",)}
SOLID_FORMATS = ("vtu", "npz", "vtkhdf", "pvtu", "matlab", "openfoam", "rf", "hedra", "ovm")
SAMPLES = {
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
SOLID_SAMPLES = ("boxes", "tetrahedra", "random_tetrahedra", "voronoi3d", "prisms", "layered", "brain3d")
PROBLEMS = {
    "diffusion": ("diffusion:Diffusion", "−∇·(κ∇u) = f; data by cell tag and boundary tag in a file."),
    "linear": ("linear:Linear", "A x = b from files, with unknowns in the cells of the mesh."),
    "constant": ("named:constant", "−Δu = 8 with u = 0 on the boundary (the paper's published counts)."),
    "sine": ("named:sine", "f = 2π² sin πx sin πy with u = 0 on the boundary (the paper's text)."),
}

SMOOTHERS = {
    "block_jacobi": ("level_smoothers:BlockJacobi", "Block Jacobi steps, damped by 4/(3 λ_max)."),
    "gauss_seidel": (
        "level_smoothers:GaussSeidel",
        "Block Gauss–Seidel: forward sweeps, then as many backward.",
    ),
    "chebyshev": (
        "level_smoothers:Chebyshev",
        "Chebyshev polynomials of the matrix, preconditioned by its diagonal blocks.",
    ),
    "vertex_patches": (
        "patch_smoother:PatchSmoother",
        "Multiplicative Schwarz on the patches of a level: linear and symmetric.",
    ),
}
MULTIGRID = {
    ("transfer", "injection"): (
        "transfers:Injection",
        "The functions of the coarse space as they are, or their L2 projections.",
    ),
    ("transfer", "smoothed"): (
        "transfers:SmoothedInjection",
        "Injection after a damped step of block Jacobi.",
    ),
    ("transfer", "aggregation"): (
        "transfers:Aggregation",
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

CONSTRAINTS = {
    "regions": ("regions:Regions", "No part holds cells of two regions: of different values of cell tags."),
    "where": ("regions:Where", "Only cells with a tag are agglomerated, all others stay single."),
    "barriers": ("barriers:BarrierTags", "No part lies on both sides of faces with a tag: fractures, walls."),
    "ridges": ("ridges:Ridges", "Cells join only those on the same boundary patches, at corners none."),
    "bounds": (
        "bounds:Bounds",
        "At most, and where possible at least, so many cells, so much measure or weight.",
    ),
}
