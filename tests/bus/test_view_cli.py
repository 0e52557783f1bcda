# SPDX-License-Identifier: MIT
"""`zygos view`: stills, the page and what it records, and the refusals."""

from __future__ import annotations

import base64
import json
import os
import re
import signal
import socket
import sys
import threading
import urllib.request
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import run
from numpy.typing import NDArray

from conftest import EXAMPLE
from zygos.arm import Arm, load_arm
from zygos.can import bus
from zygos.dynamics.pose import motion, skeleton
from zygos.native.flight import encode
from zygos.runs.cycles import Cycles

if not os.environ.get("CI"):  # there, a missing tool is a failure
    for name in ("matplotlib", "trimesh", "viser"):
        pytest.importorskip(name, reason="needs the extra: pip install 'zygos[view]'")

import matplotlib.image
import msgspec
import zstandard

from zygos.view import scene as view

Floats = NDArray[np.float64]
MODEL = EXAMPLE / "model.toml"
LINK_M, END_M, BASE_M = 10.0, 5.0, 5.0
"""Of the paper's arm: shoulder to elbow, elbow to the end, the base's mass centre to the shoulder."""
MASSES = (4001.0, 201.0, 1000.0)


def cycles(q: Floats, deflection: float = 0.0, rate: float = 0.0) -> Cycles:
    n = len(q)
    omega = np.zeros((n, 3))
    omega[:, 2] = rate
    return Cycles(np.arange(n, dtype=np.uint64), q, q + deflection, np.zeros_like(q), omega, np.zeros(n, np.uint32))


SWEEP = np.linspace([0.0, 0.0], [1.5, -1.0], 101)
"""(n, 2) rad: five seconds in which the shoulder rises and the elbow bends."""
RATE = 0.02


@pytest.fixture(autouse=True)
def small_stills(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half as wide and as high as they are for a user."""
    width, height = view.STILL_PX
    monkeypatch.setattr(view, "STILL_PX", (width // 2, height // 2))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep with the motors 0.1 rad ahead, and the base turning at RATE."""
    folder = tmp_path_factory.mktemp("sweep")
    arm = load_arm(EXAMPLE / "arm.toml")
    bus.write_log(folder / "run.log", encode(arm, cycles(SWEEP, 0.1, RATE)), arm.period_s)
    (folder / "arm.toml").write_bytes((EXAMPLE / "arm.toml").read_bytes())
    return folder / "run.log"


def pixels(path: Path) -> Floats:
    """(h, w, 3) 0 .. 1."""
    return np.asarray(matplotlib.image.imread(path), dtype=np.float64)[..., :3]


def blue(picture: Floats) -> NDArray[np.bool_]:
    """(h, w) where a link is seen; the legend at the bottom is left out."""
    red, green, shade = np.moveaxis(picture, -1, 0)
    seen = (shade - red > 0.2) & (shade > green) & (green > red)
    seen[int(0.93 * len(seen)) :] = False
    return seen


def centre(mask: NDArray[np.bool_]) -> Floats:
    """Column and row of the middle."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()])


@pytest.mark.slow
def test_a_sheet_of_stills(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "deep" / "arm.png"
    assert run("view", log, "--model", MODEL, "--png", out) == 0
    said = capsys.readouterr()
    assert "shoulder" in said.out
    assert "schematically" not in said.err
    picture = pixels(out)
    assert picture.shape[1::-1] == view.SHEET_PX
    height, width = picture.shape[0] // 2, picture.shape[1] // 3
    sheet = blue(picture)
    stills = [sheet[row * height :, column * width :][:height, :width] for row in range(2) for column in range(3)]
    assert all(still.sum() > 500 for still in stills)
    # each still is another posture: the arm goes up and to the left
    for row in (stills[:3], stills[3:]):
        assert (np.diff([centre(still) for still in row], axis=0) < -2.0).all()


@pytest.mark.slow
def test_one_still_shows_the_second_asked_for(log: Path, tmp_path: Path) -> None:
    sheets = {}
    for name, at in (("early", 0.0), ("same", 0.02), ("late", 5.0)):
        out = tmp_path / f"{name}.png"
        assert run("view", log, "--model", MODEL, "--png", out, "--at", at) == 0
        sheets[name] = pixels(out)
        assert sheets[name].shape[1::-1] == view.STILL_PX
        assert blue(sheets[name]).sum() > 500
    assert np.array_equal(sheets["early"], sheets["same"])  # the nearest cycle
    assert np.mean(np.any(sheets["early"] != sheets["late"], axis=2)) > 0.05


def test_the_ghost_follows_the_motors(log: Path, tmp_path: Path) -> None:
    """It leaves the links where the deflection is exaggerated, and hides behind them where it is drawn as nothing."""

    def orange(factor: float) -> int:
        out = tmp_path / f"{factor}.png"
        assert run("view", log, "--model", MODEL, "--png", out, "--at", 2.5, "--exaggerate", factor) == 0
        red, green, shade = np.moveaxis(pixels(out)[: int(0.93 * view.STILL_PX[1])], -1, 0)
        return int(((red - shade > 0.15) & (red > green)).sum())

    assert orange(8.0) > 2.0 * orange(0.0)


def test_schematic_without_lengths_says_so(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "arm.png"
    assert run("view", log, "--png", out, "--at", 4, "--json", "-") == 0
    said = capsys.readouterr()
    content = json.loads(said.out)
    assert content["schematic"] is True
    assert "drawn schematically" in said.err
    assert blue(pixels(out)).sum() > 125
    assert content["cycles"] == 101
    assert content["duration_s"] == pytest.approx(5.0)
    assert content["base_turned_rad"] == pytest.approx(RATE * 5.0, rel=1e-3)
    shoulder, elbow = content["joints"]
    assert (shoulder["name"], elbow["name"]) == ("shoulder", "elbow")
    assert shoulder["largest_rad"] == pytest.approx(1.5, abs=0.002)
    assert elbow["least_rad"] == pytest.approx(-1.0, abs=0.002)
    assert elbow["largest_deflection_rad"] == pytest.approx(0.1, abs=0.003)


def recorded(page: str) -> Any:
    """What viser's player will play: a length, msgpack under zstd, base64."""
    found = re.search(r'__VISER_EMBED_DATA__="([^"]+)"', page)
    assert found
    raw = zstandard.ZstdDecompressor().decompressobj().decompress(base64.b64decode(found[1])[8:])
    length = int.from_bytes(raw[:8], "little")
    return msgspec.msgpack.decode(raw[8 : 8 + length])


def by_hand(q: Floats, turned: float) -> tuple[Floats, Floats]:
    """Shoulder and elbow of the paper's arm in the plane, its mass centre at rest, by complex numbers."""
    base = np.exp(1j * turned)
    first, second = base * np.exp(1j * q[0]), base * np.exp(1j * (q[0] + q[1]))
    shoulder = BASE_M * base
    elbow = shoulder + LINK_M * first
    # rotors of 1 kg sit at the joints, on the body before
    moment = 1.0 * shoulder + 200.0 * (shoulder + 5.0 * first) + 1.0 * elbow + 1000.0 * (elbow + 2.5 * second)
    still = moment / sum(MASSES)
    return (np.array([z.real, z.imag, 0.0]) for z in (shoulder - still, elbow - still))  # type: ignore[return-value]


@pytest.mark.slow
def test_the_page_plays_the_run_without_a_network(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "arm.html"
    assert run("view", log, "--model", MODEL, "--html", out) == 0
    page = out.read_text(encoding="utf-8")
    assert set(re.findall(r'(?:src|href)="?(\w+:)', page)) <= {"data:"}
    assert page.count("</body>") == 1
    assert "about its mass centre" in page
    content = recorded(page)
    assert content["durationSeconds"] == pytest.approx(5.0)
    # each joint's cylinder stands at its joint, at the time the run had it there
    track: dict[str, dict[int, Floats]] = {"/joint 1": {}, "/joint 2": {}}
    for time, message in content["messages"]:
        if message["type"] == "SetPositionMessage" and message["name"] in track:
            track[message["name"]][round(time * 1000)] = np.array(message["position"])
    assert len(track["/joint 1"]) == 101
    for k in (0, 37, 100):
        shoulder, elbow = by_hand(SWEEP[k], RATE * 0.05 * k)
        np.testing.assert_allclose(track["/joint 1"][k * 50], shoulder, atol=0.01)
        np.testing.assert_allclose(track["/joint 2"][k * 50], elbow, atol=0.02)  # quantum 3 mrad over 10 m


def spatial(joints: int = 7) -> Arm:
    """Seven joints that roll, pitch and yaw in turn; the run path is left to planar arms."""
    arm = load_arm(EXAMPLE / "arm.toml")
    axes = [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)]
    return replace(
        arm,
        kinetic="spatial",
        joints=tuple(
            replace(arm.joints[0], name=f"j{i + 1}", node=i + 1, axis=axes[i % 2], frame_rpy=(0.0, 0.3, 0.0))
            for i in range(joints)
        ),
    )


@pytest.mark.slow(only=["7"])
@pytest.mark.parametrize("joints", [1, 7])
def test_a_spatial_arm_is_drawn(tmp_path: Path, joints: int) -> None:
    arm = spatial(joints)
    angles = np.linspace(0.0, 1.0, 40)[:, None] * np.resize([1.0, -0.8, 0.6], joints)
    moved = motion(arm, cycles(angles, deflection=0.05, rate=0.5))
    shown = view.film(arm, skeleton(arm, None), moved, view.frame_instants(moved, 2), 1.0)
    assert [part.kind for part in shown.parts].count("joint") == joints
    (tmp_path / "arm.png").write_bytes(view.png(shown))
    sheet = blue(pixels(tmp_path / "arm.png"))
    half = sheet.shape[1] // 3
    first, second = sheet[:, :half], sheet[:, half : 2 * half]
    assert min(first.sum(), second.sum()) > 300
    assert (first != second).sum() > 300


def test_gravity_points_down(tmp_path: Path) -> None:
    """An arm that hangs along its base's y axis, which points to the ground, is drawn hanging."""
    arm = load_arm(EXAMPLE / "arm.toml")
    arm = replace(arm, base="fixed", gravity=(0.0, 9.81, 0.0))
    heights = []
    for angle in (np.pi / 2, -np.pi / 2):
        moved = motion(arm, cycles(np.array([[angle, 0.0]])))
        (tmp_path / "arm.png").write_bytes(
            view.png(view.film(arm, skeleton(arm, None), moved, view.frame_instants(moved, 1), 1.0))
        )
        picture = pixels(tmp_path / "arm.png")
        grey = np.ptp(picture, axis=2) < 0.05
        base = grey & (picture.mean(axis=2) > 0.25) & (picture.mean(axis=2) < 0.6)
        base[: len(base) // 10] = base[int(0.93 * len(base)) :] = False
        heights.append(centre(blue(picture))[1] - centre(base)[1])
    assert heights[0] > 25.0  # rows count downwards
    assert heights[1] < -25.0


def test_rigid_joints_have_no_ghost() -> None:
    arm = load_arm(EXAMPLE / "arm.toml")
    rigid = replace(arm, joints=tuple(replace(joint, flexible=False) for joint in arm.joints))
    assert "motor" in {part.kind for part in view.parts(arm, skeleton(arm, None))}
    assert "motor" not in {part.kind for part in view.parts(rigid, skeleton(rigid, None))}


def test_the_browser_gets_the_page_until_interrupted(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    pages, said = [], view.note

    def look(url: str) -> None:
        """What a user does who reads where the page is: open it, and type Ctrl-C."""
        try:
            with urllib.request.urlopen(url, timeout=30) as answer:
                pages.append(answer.read().decode())
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    def told(text: str) -> None:
        said(text)
        if found := re.match(r"http://127\.0\.0\.1:\d+/", text):
            threading.Thread(target=look, args=(found[0],)).start()

    monkeypatch.setattr(view, "note", told)
    assert run("view", log, "--model", MODEL) == 0
    (page,) = pages
    assert recorded(page)["durationSeconds"] == pytest.approx(5.0)
    assert "in the browser: 101 cycles" in capsys.readouterr().out


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert run("view", *arguments) == 2
    said = capsys.readouterr().err
    assert "remedy:" in said
    assert "Traceback" not in said
    return said


def test_refusals(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    png = tmp_path / "arm.png"
    other = tmp_path / "other.toml"
    other.write_text(MODEL.read_text().replace('name = "elbow"', 'name = "wrist"'))
    assert "wrist" in refused(capsys, log, "--model", other, "--png", png)
    assert "lasts from 0 to 5 s" in refused(capsys, log, "--png", png, "--at", 5.1)
    assert "lasts from 0 to 5 s" in refused(capsys, log, "--png", png, "--at", -1)
    assert "--at" in refused(capsys, log, "--html", tmp_path / "arm.html", "--at", 1)
    assert "would replace" in refused(capsys, log, "--png", log)
    assert "not a regular file" in refused(capsys, log, "--png", tmp_path)
    (tmp_path / "file").write_text("")
    assert "cannot be written" in refused(capsys, log, "--png", tmp_path / "file" / "arm.png")
    assert not png.exists()


def test_a_run_without_cycles_is_refused(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = bus.read_log(log).frames
    bus.write_log(tmp_path / "sync.log", frames[frames["id"] == 0x080], 0.05)
    arm = ("--arm", EXAMPLE / "arm.toml")
    assert "no complete cycle" in refused(capsys, tmp_path / "sync.log", *arm, "--png", tmp_path / "arm.png")
    assert not (tmp_path / "arm.png").exists()


def test_a_port_that_is_taken_is_refused(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert f"port {port} cannot be opened" in refused(capsys, log, "--port", port)


def test_without_the_extra_the_remedy_is_said(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    for module in ("zygos.view.scene", "zygos.cli.view"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    said = refused(capsys, log)
    assert "needs viser" in said
    assert "pip install 'zygos[view]'" in said
