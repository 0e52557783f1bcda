# SPDX-License-Identifier: MIT
"""The arm of a recorded run moving in space: still pictures in a PNG, or a page that any browser can play."""

from __future__ import annotations

import io
import os
import sys
import webbrowser
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import Arm
from zygos.dynamics.pose import Floats, Poses, RecordedMotion, Skeleton, forward, place
from zygos.errors import ZygosError, installs
from zygos.files.output import (
    note,
)
from zygos.files.signals import stop_signals

try:
    import trimesh
    import viser
    from matplotlib.colors import LightSource
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection
except ImportError as error:
    raise ZygosError(f"drawing the arm needs {error.name}; remedy: {installs('view')}") from error


STILLS = 6
"""Number of stills on a sheet, evenly distributed over the run."""


SHEET_PX, STILL_PX = (1800, 1250), (1200, 950)
"""Width and height of a PNG with several stills, and of one with a single still."""


FRAMES_PER_S, MOST_FRAMES = 25.0, 3000
"""Largest number of frames of a page; a longer run is played at the same speed with fewer frames per second."""


@dataclass(frozen=True)
class Paint:
    """Colour and opacity of a kind of part."""

    colour: tuple[int, int, int]
    opacity: float
    legend: str

    @property
    def rgba(self) -> tuple[float, float, float, float]:
        """Red, green, blue and opacity, 0 .. 1."""
        red, green, blue = self.colour
        return red / 255, green / 255, blue / 255, self.opacity


PAINTS = {
    "base": Paint((128, 134, 140), 1.0, "base"),
    "link": Paint((52, 120, 190), 1.0, "links (q)"),
    "joint": Paint((45, 48, 56), 1.0, "joints, along their axes"),
    "motor": Paint((230, 110, 10), 0.5, "motor angles (θ)"),
}


@dataclass(frozen=True)
class Part:
    """A rigid piece of a body."""

    kind: str
    body: int
    vertices: Floats
    """(v, 3) in the body's frame, m."""
    faces: NDArray[np.integer]
    """(f, 3) vertices of each triangle."""


@dataclass(frozen=True)
class Film:
    """An arm with N joints at m instants. The world's z axis is up."""

    arm: Arm
    parts: tuple[Part, ...]
    time: Floats
    """(m,) time, s."""
    links: Poses
    """Poses of the bodies by the link encoders."""
    motors: Poses
    """Poses that the bodies would have if every link were at its motor's angle."""
    caption: str

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of parts that occur, each once."""
        return tuple(dict.fromkeys(part.kind for part in self.parts))

    @property
    def grid_m(self) -> float:
        """Cell width of a grid that suits the arm's size: 1, 2 or 5 times a power of ten, m."""
        least = 0.2 * float(self.bounds[1].max())
        power = 10.0 ** np.floor(np.log10(least))
        return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least))

    def poses(self, part: Part) -> Poses:
        """The poses by which a part moves."""
        return self.motors if part.kind == "motor" else self.links

    def vertices(self, part: Part) -> Floats:
        """(m, v, 3) a part's vertices in the world, m."""
        poses = self.poses(part)
        turned = part.vertices @ np.swapaxes(poses.attitude[:, part.body], -1, -2)
        return np.asarray(turned + poses.position[:, part.body, None])

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Centre (3,) and half the extent (3,) of everything that is visible at any time, m."""
        low = np.min([self.vertices(part).min(axis=(0, 1)) for part in self.parts], axis=0)
        high = np.max([self.vertices(part).max(axis=(0, 1)) for part in self.parts], axis=0)
        return 0.5 * (low + high), 0.5 * (high - low)


def parts(arm: Arm, lengths: Skeleton) -> tuple[Part, ...]:
    """Base as a box, links as cylinders from joint to joint, joints as cylinders along their axes, all in proportion.

    The motor angles are shown by a second set of links, thinner so that they are hidden inside the first where both
    coincide. An arm without springs has no second set.
    """
    ends = np.vstack([lengths.joint_xyz, lengths.end_xyz])
    reach = np.linalg.norm(ends, axis=1)
    size = float(np.mean(reach[reach > 0.0])) if reach.any() else 1.0
    thick = 0.05 * size
    made = [_box("base", lengths.centre_xyz[0], ends[0], 0.2 * size)]
    ghost = any(joint.flexible for joint in arm.joints)
    for i, joint in enumerate(arm.joints, start=1):
        axis = np.array(joint.axis)
        made.append(_cylinder("joint", i, -2.2 * thick * axis, 2.2 * thick * axis, 1.8 * thick))
        if reach[i] > 0.0:
            made.append(_cylinder("link", i, np.zeros(3), ends[i], thick))
            if ghost:
                made.append(_cylinder("motor", i, np.zeros(3), ends[i], 0.7 * thick))
    return tuple(made)


def _box(kind: str, centre: Floats, corner: Floats, least: float) -> Part:
    """The base: a box about its mass centre, up to its joint, at least 2 `least` thick; small faces, see
    `_cylinder`."""
    half = np.maximum(np.abs(corner - centre), least)
    mesh = trimesh.creation.box(extents=2.0 * half).subdivide_to_size(0.25 * half.max())
    return Part(kind, 0, mesh.vertices + centre, mesh.faces)


def _cylinder(kind: str, body: int, start: Floats, end: Floats, radius: float) -> Part:
    """A cylinder divided into rings, because matplotlib sorts only small faces correctly by depth."""
    length = float(np.linalg.norm(end - start))
    rings = [(radius, z) for z in np.linspace(0.0, length, 9)]
    mesh = trimesh.creation.revolve([(0.0, 0.0), *rings, (0.0, length)], sections=24)
    turn = Rotation.align_vectors([(end - start) / length], [[0.0, 0.0, 1.0]])[0]
    return Part(kind, body, turn.apply(mesh.vertices) + start, mesh.faces)


def up(arm: Arm) -> Floats:
    """(3,) direction that is drawn upwards, in the base frame: against gravity, else along a planar arm's axis, else
    z."""
    if any(arm.gravity):
        return np.asarray(-np.array(arm.gravity) / np.linalg.norm(arm.gravity))
    return np.array([0.0, 0.0, 1.0]) if arm.spatial else arm.axis


def film(arm: Arm, lengths: Skeleton, run: RecordedMotion, cycles: NDArray[np.int64], exaggerate: float) -> Film:
    """The arm at chosen cycles (m,), with the deflections of the motors enlarged by a factor."""
    upright = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up(arm)])[0].as_matrix()
    q, base = run.q[cycles], upright @ run.base[cycles]
    links = place(arm, lengths, q, base)
    driven = q + exaggerate * run.deflection[cycles]
    motors = forward(arm, lengths.joint_xyz, driven, base, links.position[:, 0])
    about = "about its base" if lengths.mass is None else "about its mass centre"
    caption = [f"arm {arm.name}", about if arm.free else "on the ground"]
    if lengths.mass is None:
        caption.append("schematic: all lengths are 1")
    if exaggerate != 1.0:
        caption.append(f"θ − q enlarged {exaggerate:g} times")
    return Film(arm, parts(arm, lengths), run.time[cycles], links, motors, " · ".join(caption))


def view_direction(arm: Arm) -> Floats:
    """(3,) direction from the arm to the eye, with z up: perpendicular to a planar arm's plane, else from the side."""
    if arm.spatial:
        return np.array([0.75, -0.55, 0.37])
    axis = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up(arm)])[0].apply(arm.axis)
    side = np.array([0.0, -1.0, 0.0]) if abs(axis[2]) > 0.9 else np.cross(axis, [0.0, 0.0, 1.0])
    towards = axis + 0.4 * np.array([0.0, 0.0, 1.0]) + 0.6 * side
    return np.asarray(towards / np.linalg.norm(towards))


def png(shown: Film) -> bytes:
    """The film's instants as stills on one sheet; needs neither a screen nor a GPU."""
    several = len(shown.time) > 1
    columns = 3 if several else 1
    rows = -(-len(shown.time) // columns)
    width, height = SHEET_PX if several else STILL_PX
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    middle, half = shown.bounds
    half = np.maximum(half, 0.3 * half.max())
    eye = view_direction(shown.arm)
    elevation, azimuth = np.degrees(np.arcsin(eye[2])), np.degrees(np.arctan2(eye[1], eye[0]))
    right = np.cross([0.0, 0.0, 1.0], eye) / np.hypot(eye[0], eye[1])
    beside = 0.07 * half.max() * (right + np.cross(eye, right))  # up and to the right as seen from the eye
    light = LightSource(
        azdeg=90.0 - azimuth + 40.0, altdeg=50.0
    )  # over the viewer's left shoulder; given as a compass angle
    vertices = [shown.vertices(part) for part in shown.parts]
    for at, time in enumerate(shown.time):
        axes = figure.add_subplot(rows, columns, at + 1, projection="3d", proj_type="persp")
        triangles = [where[at][part.faces] for part, where in zip(shown.parts, vertices, strict=True)]
        colours = [np.tile(PAINTS[part.kind].rgba, (len(part.faces), 1)) for part in shown.parts]
        faces = np.concatenate(colours)
        seams = faces * (1.0, 1.0, 1.0, 0.0) + np.outer(faces[:, 3] == 1.0, (0.0, 0.0, 0.0, 1.0))
        # one collection, so that near faces hide far ones of other parts; edges close the gaps between opaque faces
        axes.add_collection3d(
            Poly3DCollection(
                np.concatenate(triangles),
                facecolors=faces,
                edgecolors=seams,
                linewidths=0.4,
                shade=True,
                lightsource=light,
            )
        )
        for joint, where in zip(shown.arm.joints, shown.links.position[at, 1:], strict=True):
            paper = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 1}
            axes.text(*(where + beside), joint.name, fontsize=9, zorder=1e6, bbox=paper)
        (left, right), (front, back), (low, high) = zip(middle - half, middle + half, strict=True)
        axes.set(xlim=(left, right), ylim=(front, back), zlim=(low, high), title=f"{time:.2f} s", xlabel="m")
        axes.set_box_aspect(tuple(half), zoom=1.05)
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_major_locator(MaxNLocator(5))
            axis.set_tick_params(labelsize=8)
        axes.view_init(elev=elevation, azim=azimuth)
    legend = [Patch(color=PAINTS[kind].rgba, label=PAINTS[kind].legend) for kind in shown.kinds]
    figure.legend(handles=legend, loc="lower center", ncols=len(legend), frameon=False, fontsize=11)
    figure.suptitle(shown.caption, fontsize=13)
    figure.subplots_adjust(left=0.02, right=0.98, bottom=0.08, top=0.9, wspace=0.04, hspace=0.12)
    out = io.BytesIO()
    figure.savefig(out, format="png")
    return out.getvalue()


def page(shown: Film, progress: Callable[[int], None]) -> str:
    """The film as one HTML page with a player, which needs no network; progress gets the number of finished frames."""
    # viser prints messages on stdout, which would mix with the output of the command
    with redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            content = _record(shown, server, progress)
        finally:
            server.stop()
    swatches = "".join(
        f'<br><span style="color:rgba({",".join(map(str, (*paint.colour, max(paint.opacity, 0.6))))})">■</span> '
        f"{escape(paint.legend)}"
        for paint in (PAINTS[kind] for kind in shown.kinds)
    )
    legend = (
        '<div style="position:fixed;top:1em;right:1em;font:14px sans-serif;background:#ffffffc0;padding:.6em">'
        f"{escape(shown.caption)}<br>grid {shown.grid_m:g} m{swatches}</div>"
    )
    content = content.replace("<title>Viser</title>", f"<title>{escape(shown.caption)}</title>")
    head, end, tail = content.rpartition("</body>")
    return head + legend + end + tail


def _grid(shown: Film) -> Floats:
    """(k, 2, 3) ends of the lines of a grid below everything visible, m. viser's own grid is slow without a GPU."""
    middle, half = shown.bounds
    steps = np.arange(-10, 11) * shown.grid_m
    along = np.array([[[step, steps[0], 0.0], [step, steps[-1], 0.0]] for step in steps])
    lines = np.concatenate([along, along[:, :, [1, 0, 2]]])
    return np.asarray(lines + np.array([middle[0], middle[1], middle[2] - half[2]]))


def _record(shown: Film, server: viser.ViserServer, progress: Callable[[int], None]) -> str:
    """Build the scene and move it; returns the page of that recording."""
    middle, half = shown.bounds
    extent = float(np.linalg.norm(half))
    camera, scene = server.initial_camera, server.scene
    camera.look_at, camera.position = middle, middle + 2.6 * extent * view_direction(shown.arm)
    camera.fov, camera.near, camera.far = np.radians(45.0), 0.01 * extent, 100.0 * extent
    scene.add_line_segments(
        "/grid", points=_grid(shown), colors=(200, 200, 200), thickness=1.0, thickness_units="screen"
    )
    moved = []
    for part in shown.parts:
        paint, poses = PAINTS[part.kind], shown.poses(part)
        node = scene.add_mesh_simple(
            f"/{part.kind} {part.body}",
            part.vertices,
            part.faces,
            color=paint.colour,
            opacity=paint.opacity if paint.opacity < 1.0 else None,
            flat_shading=True,
        )
        turns = Rotation.from_matrix(poses.attitude[:, part.body]).as_quat(scalar_first=True)
        moved.append((node, poses.position[:, part.body], turns))
    for i, joint in enumerate(shown.arm.joints, start=1):
        scene.add_label(f"/joint {i}/name", joint.name)
    recording = server.get_scene_serializer()
    for at, pause in enumerate(np.append(np.diff(shown.time), 0.0)):
        for node, positions, turns in moved:
            node.position, node.wxyz = positions[at], turns[at]
        recording.insert_sleep(float(pause))
        progress(at + 1)
    return str(recording.as_html())


def frame_instants(run: RecordedMotion, most: int) -> NDArray[np.intp]:
    """(m,) at most `most` cycles, evenly distributed over the time of a run, including the first and the last."""
    even = np.linspace(0.0, run.time[-1], most)
    return np.unique(np.searchsorted(run.time, even - 1e-9))


def serve(content: str, port: int) -> None:
    """Serve a page to this machine's browser until Ctrl-C or SIGTERM. Errors: ZygosError if the port is in use."""
    body = content.encode()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Do not log requests."""

    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    except (OSError, OverflowError) as error:
        raise ZygosError(
            f"port {port} cannot be opened ({error}); remedy: use another --port, or --html FILE"
        ) from error
    with server, stop_signals() as stopped:
        url = f"http://127.0.0.1:{server.server_port}/"
        # without a screen, a text browser would occupy the terminal
        screen = sys.platform != "linux" or any(name in os.environ for name in ("DISPLAY", "WAYLAND_DISPLAY"))
        note(f"{url} shows the arm; Ctrl-C ends")
        if not (screen and webbrowser.open(url)):
            note("there is no screen here; remedy: open it through `ssh -L`, or use --html FILE or --png FILE")
        server.timeout = 0.2
        while not stopped():
            server.handle_request()
