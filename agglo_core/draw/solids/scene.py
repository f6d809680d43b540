"""Views of agglomerates in 3-D by pyvista, in an interactive window or as a picture."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.draw.colours import PALETTE, colouring, rgb
from agglo_core.draw.solids.surfaces import SIDE, axes_of, check_explode, mark_cells_beyond, outer_faces
from agglo_core.errors import FileError, MeshError, OptionError
from agglo_core.interchange.pyvista_grids import to_pyvista
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_SIZE: Final = (1200, 900)  # window size in pixels
_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
_FURTHEST = 2.0
"""Upper end of the explosion slider."""
_COLOURS: Final = {"scalars": "colour", "rgb": True, "ambient": 0.4}
_EDGES: Final = {"show_edges": True, "edge_color": "#444444", "edge_opacity": 0.4}
_STYLE: Final = {**_COLOURS, **_EDGES}


def view(
    hierarchy: Hierarchy,
    level: int = 0,
    *,
    explode: float = 0.0,
    section: Sequence[float] | None = None,
    path: str | os.PathLike[str] | None = None,
) -> None:
    """Show a level of a 3-D mesh in an interactive window, or write a picture.

    The window has sliders for level and explosion. With a section, the mesh is cut by a movable plane.

    Parameters
    ----------
    hierarchy : Hierarchy
        Hierarchy of a 3-D mesh.
    level : int
        Level, 0 for the finest.
    explode : float
        Agglomerates are moved by this factor, from 0 to 10, times the vector from the mesh centre to
        their centre.
    section : (3,) float, optional
        Normal of a plane through the middle. The mesh beyond the plane is cut away, through cells.
    path : path, optional
        Picture to write instead of opening a window: .png, .jpg, .bmp or .tif.

    Raises
    ------
    OptionError
        Without pyvista, without a display for the window, for invalid ``explode`` or ``section``, or both
        together.
    MeshError
        If the hierarchy has no mesh, or a 2-D mesh.
    FileError
        If the picture cannot be written, or its suffix is unknown.
    IndexError
        For a level that does not exist.
    """
    # Check all arguments.
    mesh = _solid(hierarchy)
    if not 0 <= level < len(hierarchy.levels):
        raise IndexError(
            f"level {level} is out of range: the hierarchy has levels 0..{len(hierarchy.levels) - 1}"
        )
    labels = hierarchy.levels[level]
    explode = check_explode(explode)
    if section is not None:
        mark_cells_beyond(mesh, section)
        if explode:
            raise OptionError("explode cannot be combined with section: give one of them")
    plotter = _plotter(None if path is None else _check_suffix(Path(path)))
    # Fill the scene.
    if section is not None:
        _add_cut_mesh(plotter, mesh, labels, np.array(section, dtype=float), moves=path is None)
    else:
        _parts(plotter, mesh, labels, explode)
        if path is None:
            _sliders(plotter, hierarchy, level, explode)
    # Set the camera, then show or write.
    plotter.view_vector(axes_of(*SIDE)[2], viewup=(0, 0, 1))
    plotter.camera.zoom(1.3)
    if path is None:
        plotter.show()
    else:
        _write(plotter, Path(path))


def _solid(hierarchy: Hierarchy) -> Mesh:
    if hierarchy.fine is None:
        raise MeshError("this hierarchy belongs to a graph: there is nothing to view")
    if hierarchy.fine.dim != 3:
        raise MeshError("view shows 3-D meshes; for 2-D meshes use agglo_core.plot.draw")
    return hierarchy.fine


def _check_suffix(path: Path) -> Path:
    if path.suffix.lower() not in _PICTURES:
        raise FileError(f"{path}: pictures of a view end in {', '.join(_PICTURES)}, given {path.suffix!r}")
    return path


def _plotter(path: Path | None) -> Any:
    """Return an empty pyvista scene, without a window if a picture is to be written."""
    try:
        import pyvista
    except ImportError as error:
        raise OptionError(f'view needs pyvista: pip install "agglo[view]" ({error})') from error
    elsewhere = path is not None or pyvista.OFF_SCREEN or "ipykernel" in sys.modules
    displays = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not elsewhere and sys.platform.startswith("linux") and not displays:
        raise OptionError("view: no display is available for a window; pass path= to write a picture instead")
    return pyvista.Plotter(off_screen=True if path is not None else None, window_size=list(_SIZE))


def _tones(mesh: Mesh, labels: Int) -> Any:
    """Return a colour for each part ``(k, 3)``, as red, green and blue from 0 to 255."""
    tones: Float = np.array([rgb(colour) for colour in PALETTE])
    return np.rint(255.0 * tones[colouring(mesh.coarsen(labels), len(PALETTE))]).astype(np.uint8)


def _parts(plotter: Any, mesh: Mesh, labels: Int, explode: float) -> None:
    """Draw the outer faces of the parts in the scene, and replace those drawn before."""
    import pyvista

    surface = outer_faces(mesh, labels, explode)
    sizes = np.diff(surface.offsets)
    loops = np.insert(np.arange(len(surface.corners)), surface.offsets[:-1], sizes)
    shown = pyvista.PolyData(surface.corners + mesh.origin, faces=loops)
    shown.cell_data["colour"] = _tones(mesh, labels)[surface.parts]
    plotter.add_mesh(shown, name="parts", **_STYLE)


def _add_cut_mesh(plotter: Any, mesh: Mesh, labels: Int, normal: Float, *, moves: bool) -> None:
    """Add the mesh on one side of a plane to the scene, with a handle to move the plane if ``moves``."""
    grid = to_pyvista(mesh)
    grid.cell_data["colour"] = _tones(mesh, labels)[labels]
    place = {"normal": normal, "origin": mesh.origin}
    if moves:
        plotter.add_mesh_clip_plane(grid, **place, **_STYLE)
    else:
        plotter.add_mesh(grid.clip(**place), **_STYLE)


def _sliders(plotter: Any, hierarchy: Hierarchy, level: int, explode: float) -> None:
    """Add sliders for the level and for the distance between parts to the window."""
    mesh, state = _solid(hierarchy), {"level": float(level), "explode": explode}

    def follow(key: str) -> Callable[[float], None]:
        def change(value: float) -> None:
            state[key] = value
            _parts(plotter, mesh, hierarchy.levels[round(state["level"])], state["explode"])

        return change

    style = {"style": "modern", "interaction_event": "end"}
    places = {"explode": ((0.55, 0.08), (0.95, 0.08)), "level": ((0.05, 0.08), (0.45, 0.08))}
    last = len(hierarchy.levels) - 1
    ranges = {"explode": (0.0, max(_FURTHEST, explode))} | ({"level": (0.0, float(last))} if last else {})
    for key, bounds in ranges.items():
        ends = dict(zip(("pointa", "pointb"), places[key], strict=True))
        plotter.add_slider_widget(follow(key), bounds, value=state[key], title=key, **ends, **style)


def _write(plotter: Any, path: Path) -> None:
    from agglo_core.io.atomic import staging

    try:
        with staging(path) as folder:
            plotter.screenshot(folder / path.name)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        plotter.close()
