# SPDX-License-Identifier: MIT
"""URDF in and out, against Pinocchio's own reading of the same file."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize
from urdf_support import answers, inertial, mass_matrix, numbers, pin_of_import, pin_of_urdf, posture, random_urdf

from conftest import ROOT, need
from zygos.arm import Arm, load_arm
from zygos.cli.import_urdf import import_urdf
from zygos.errors import Undecided, ZygosError
from zygos.model.model import Body, Model, Quantity, load_model, save_model
from zygos.model.nearest import entries_of, nearest_bodies
from zygos.reference.compare import sizes
from zygos.urdf.chain import read_chain, read_chain_of, with_inertials

EXAMPLE = ROOT / "examples" / "urdf"
GAP, SPATIAL = ROOT / "examples" / "gap", ROOT / "examples" / "spatial"
LINK = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


def imported(text: str, folder: Path, joints: list[str], base: str | None = None, tip: str | None = None) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "in.urdf").write_text(text)
    (folder / "answers.toml").write_text(answers(joints))
    out = folder / "out"
    import_urdf(folder / "in.urdf", out, base, tip, folder / "answers.toml", None, "-")
    load_arm(out / "arm.toml")
    load_model(out / "model.toml")
    return out


def assert_the_same_robot(urdf: pin.Model, found: pin.Model, rng: np.random.Generator) -> None:
    for _ in range(5):
        q = posture(rng, found.nv - 6)
        # Pinocchio turns a continuous joint by cosine and sine
        own = np.concatenate(
            [q[:7]]
            + [
                [np.cos(angle), np.sin(angle)] if joint.nq == 2 else [angle]
                for joint, angle in zip(list(urdf.joints)[2:], q[7:], strict=True)
            ]
        )
        expected, actual = mass_matrix(urdf, own), mass_matrix(found, q)
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
        np.testing.assert_allclose(
            pin.centerOfMass(found, found.createData(), q), pin.centerOfMass(urdf, urdf.createData(), own), atol=1e-10
        )
    assert pin.computeTotalMass(found) == pytest.approx(pin.computeTotalMass(urdf), rel=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_an_imported_arm_is_the_urdfs_arm(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(seed)
    text, joints, held = random_urdf(rng, int(rng.integers(1, 8)), held=seed % 3 == 0)
    tip = None if not held else f"l{len(joints)}"
    out = imported(text, tmp_path, joints, tip=tip)
    assert_the_same_robot(pin_of_urdf(text, held), pin_of_import(out), rng)
    assert all(name in capsys.readouterr().err for name in held[:1])


@pytest.mark.parametrize("pitch", ["1.5707963", "-1.5707963", "1.570796326794897", "1.57"])
def test_a_pitch_near_90_degrees_keeps_its_attitude(
    pitch: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """1.5707963 is what people write; Euler angles that give up there are wrong by 3e-8."""
    rng = np.random.default_rng(4)
    text, joints, _ = random_urdf(rng, 1)
    bent = (
        '<link name="bent"/><joint name="bend" type="fixed"><parent link="l1"/><child link="bent"/>'
        f'<origin xyz="1 2 3" rpy="0.3 {pitch} 0.7"/></joint><link name="end">{inertial(rng)}</link>'
        '<joint name="last" type="revolute"><parent link="bent"/><child link="end"/><origin xyz="0 0 1"/>'
        '<axis xyz="0 0 1"/><limit effort="1" velocity="1" lower="-1" upper="1"/></joint></robot>'
    )
    text = text.replace("</robot>", bent)
    out = imported(text, tmp_path, [*joints, "last"])
    assert_the_same_robot(pin_of_urdf(text, []), pin_of_import(out), np.random.default_rng(0))


def test_a_base_below_the_root_carries_what_is_above(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The base's frame is another, so only what it has no part in is compared: the inertia of the floating arm as its
    joints feel it."""
    rng = np.random.default_rng(2)
    text, joints, _ = random_urdf(rng, 3)
    text = text.replace(
        "</robot>",
        '<link name="top"><inertial><origin xyz="1 0 0"/><mass value="5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link><joint name="up" type="fixed"><parent link="top"/><child link="l0"/>'
        '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/></joint></robot>',
    ).replace("revolute", "continuous")
    found = pin_of_import(imported(text, tmp_path, joints, base="l0"))
    urdf = pin_of_urdf(text, [])
    q = posture(rng, 3)
    turned = np.concatenate([q[:7], np.ravel([[np.cos(angle), np.sin(angle)] for angle in q[7:]])])

    def felt(m: np.ndarray) -> np.ndarray:
        return m[6:, 6:] - m[6:, :6] @ np.linalg.solve(m[:6, :6], m[:6, 6:])

    np.testing.assert_allclose(felt(mass_matrix(found, q)), felt(mass_matrix(urdf, turned)), rtol=1e-9, atol=1e-10)
    assert pin.computeTotalMass(found) == pytest.approx(pin.computeTotalMass(urdf), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_what_is_exported_comes_back(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(seed)
    text, joints, held = random_urdf(rng, int(rng.integers(1, 8)), held=seed % 2 == 0)
    tip = None if not held else f"l{len(joints)}"
    model = load_model(imported(text, tmp_path / "first", joints, tip=tip) / "model.toml")
    heavier = replace(
        model,
        bodies=tuple(replace(body, mass=Quantity(body.mass.value * rng.uniform(0.5, 2))) for body in model.bodies),
    )
    source = tmp_path / "first" / "in.urdf"
    chain = read_chain_of(source, "l0", joints)
    written = with_inertials(source, chain.segments, heavier.bodies, "two -- hyphens")
    back = load_model(imported(written, tmp_path / "second", joints, tip=tip) / "model.toml")
    for before, after in zip(heavier.bodies, back.bodies, strict=True):
        np.testing.assert_allclose(entries_of(after), entries_of(before), rtol=1e-12, atol=1e-12)
        assert after.joint_xyz == before.joint_xyz
    # whoever else reads it finds the same masses, and none twice
    masses = sum(body.mass.value for body in heavier.bodies)
    assert pin.computeTotalMass(pin_of_urdf(written, held)) == pytest.approx(masses, rel=1e-12)


def test_all_but_the_inertials_stays_as_it_is() -> None:
    chain, inertials = read_chain(EXAMPLE / "arm.urdf")
    bodies = [Body(segment.link, Quantity(1.0), (0.0, 0.0, 0.0), (Quantity(1.0),) * 6) for segment in chain.segments]
    assert len(inertials) == len(bodies) == 8

    def without(text: str) -> str:
        return re.sub(r"\s*<inertial>.*?</inertial>", "", text, flags=re.DOTALL)

    written = with_inertials(EXAMPLE / "arm.urdf", chain.segments, bodies)
    assert without(written) == without((EXAMPLE / "arm.urdf").read_text())
    assert written.count("<inertial>") == 8


SOUND = f"""<robot name="r"><link name="a">{LINK}</link><link name="b">{LINK}</link><link name="c">{LINK}</link>
<joint name="one" type="continuous"><parent link="a"/><child link="b"/></joint>
<joint name="two" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 2"/></joint></robot>"""


def swapped(before: str, after: str, times: int = 1) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert before in text
        return text.replace(before, after, times)

    return change


BROKEN: dict[str, tuple[Callable[[str], str], str]] = {
    "XML": (swapped("</robot>", ""), "is not valid XML"),
    "root": (lambda text: "<sdf/>", "is not a URDF"),
    "xacro": (
        swapped('<robot name="r">', '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/>'),
        "xacro FILE.xacro",
    ),
    "empty": (lambda text: '<robot name="r"/>', "has no <link>"),
    "no number": (swapped('value="2"', 'value="heavy"'), "heavy"),
    "no finite number": (swapped('value="2"', 'value="nan"'), "link a has the mass nan"),
    "no mass in the middle": (swapped(f'"b">{LINK}', '"b">'), "link b has no mass"),
    "negative mass": (swapped('value="2"', 'value="-2"'), "mass -2"),
    "inertia without mass": (swapped('value="2"', 'value="0"'), "inertia but no mass"),
    "mass without inertia": (swapped(LINK, '<inertial><mass value="2"/></inertial>'), "without <inertia>"),
    "triangle": (swapped('ixx="1"', 'ixx="2.2"'), "principal moments"),
    "triangle within digits that are given": (
        lambda text: text.replace('="1"', '="1.000"').replace('ixx="1.000"', 'ixx="2.005"', 1),
        "principal moments",
    ),
    "negative inertia": (swapped('ixx="1"', 'ixx="-1"'), "principal moments"),
    "point mass": (lambda text: re.sub(r'(i..)="1"', r'\1="0"', text), "principal moments"),
    "two inertials": (swapped(LINK, LINK + LINK), "has 2 <inertial>"),
    "unknown parent": (swapped('parent link="a"', 'parent link="aa"'), "did you mean a?"),
    "unknown type": (swapped("continuous", "hinge"), "hinge"),
    "two parents": (
        swapped("</robot>", '<joint name="x" type="fixed"><parent link="a"/><child link="c"/></joint></robot>'),
        "is the child of two joints",
    ),
    "circle": (
        swapped("</robot>", '<joint name="x" type="fixed"><parent link="c"/><child link="a"/></joint></robot>'),
        "form a loop",
    ),
    "circle apart": (
        swapped(
            "</robot>",
            '<link name="d"/><link name="e"/><joint name="x" type="fixed"><parent link="d"/><child link="e"/></joint>'
            '<joint name="y" type="fixed"><parent link="e"/><child link="d"/></joint></robot>',
        ),
        "d, e form a loop",
    ),
    "two roots": (
        swapped(
            "</robot>",
            '<link name="d"/><link name="e"/><joint name="x" type="fixed"><parent link="d"/><child link="e"/></joint>'
            "</robot>",
        ),
        "a, d have no parent",
    ),
    "twice": (swapped('name="b"', 'name="a"'), "two links are called a"),
    "zero axis": (swapped("0 0 2", "0 0 0"), "has no direction"),
    "short axis": (swapped("0 0 2", "0 2"), "vector length"),
    "prismatic": (swapped("revolute", "prismatic"), "joint two is prismatic"),
    "floating": (swapped("revolute", "floating"), "joint two is floating"),
    "planar": (swapped("revolute", "planar"), "joint two is planar"),
    "mimic": (
        swapped('<axis xyz="0 0 2"/>', '<mimic joint="one"/>'),
        "mimics one: it has no motor of its own, and coupled",
    ),
    "nothing turns": (lambda text: text.replace("continuous", "fixed").replace("revolute", "fixed"), "no joint turns"),
    "branches": (
        swapped(
            "</robot>",
            f'<link name="d">{LINK}</link><joint name="x" type="continuous"><parent link="b"/><child link="d"/></joint>'
            "</robot>",
        ),
        "branches at link b: moving joints end at the links c, d; remedy: choose the end of the arm with --tip, for "
        "instance --tip b",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_urdf_is_refused(name: str, tmp_path: Path) -> None:
    change, words = BROKEN[name]
    file = tmp_path / "arm.urdf"
    file.write_text(SOUND)
    read_chain(file)
    file.write_text(change(SOUND))
    with pytest.raises(ZygosError, match=re.escape(words)) as caught:
        read_chain(file)
    assert "; remedy: " in str(caught.value)
    assert str(file) in str(caught.value)


def test_what_floats_off_is_no_part_of_the_arm(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    world = '<link name="world">{}</link><joint name="orbit" type="floating"><parent link="world"/><child link="a"/>'
    file.write_text(SOUND.replace("</robot>", world.format("") + "</joint></robot>"))
    chain, inertials = read_chain(file, base="a")
    assert [segment.merged for segment in chain.segments] == [(), (), ()]
    assert [inertial.mass for inertial in inertials] == [2.0, 2.0, 2.0]
    with pytest.raises(ZygosError, match="joint orbit is floating: the joints of the chain must turn"):
        read_chain(file)
    file.write_text(SOUND.replace("</robot>", world.format(LINK) + '</joint><link name="cup"/></robot>'))
    chain, inertials = read_chain(file, base="a")
    assert [inertial.mass for inertial in inertials] == [2.0, 2.0, 2.0]
    assert "left out, because nothing fixes it to the arm: link world, cup" in chain.notes


def test_a_world_that_the_file_does_not_have_is_empty(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    hung = '<joint name="hung" type="fixed"><parent link="{}"/><child link="a"/><origin xyz="0 0 1"/></joint></robot>'
    file.write_text(SOUND.replace("</robot>", hung.format("world")))
    chain, inertials = read_chain(file)
    assert [segment.link for segment in chain.segments] == ["world", "b", "c"]
    assert inertials[0].mass == 2.0 and inertials[0].centre[2] == 1.0
    assert any("no link world, which is taken as an empty one" in note for note in chain.notes)
    file.write_text(SOUND.replace("</robot>", hung.format("table")))
    with pytest.raises(ZygosError, match="names the link table, which the file does not have"):
        read_chain(file)


def shared_case(name: str) -> str:
    file = ROOT.parent / "shared" / "cases" / name
    need(file.is_file(), f"the case {name}")
    return file.read_text()


def test_a_gripper_outside_of_the_chain_is_held(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its fingers slide, and one mimics the other: masses, centres and inertias are Pinocchio's."""
    text = shared_case("urdf_mimic_on_gripper_branch_with_tip.urdf").replace(
        '<link name="base"></link>', f'<link name="base">{LINK}</link>'
    )
    out = imported(text, tmp_path, ["j1", "j2"], tip="l2")
    assert_the_same_robot(pin_of_urdf(text, ["g1", "g2"]), pin_of_import(out), np.random.default_rng(0))
    assert "outside the chain and fixed at zero: joint g1, g2" in capsys.readouterr().err
    with pytest.raises(ZygosError, match=r"the tree branches at link l2: .* for instance --tip l2"):
        read_chain(tmp_path / "in.urdf")


def test_an_inertia_that_is_wrong_by_less_than_its_digits_is_rounded(tmp_path: Path) -> None:
    """To the nearest one that a body can have, which then lies in a plane; the other links stay as they are."""
    file = tmp_path / "arm.urdf"
    text = shared_case("urdf_small_merged_link_breaks_triangle.urdf")
    file.write_text(text)
    chain, inertials = read_chain(file)
    (note,) = (line for line in chain.notes if "grip_motor" in line)
    assert "exceeded the sum of the other two by 5.8e-06 kg m^2, less than the last digit" in note
    given = np.array([[11.5, 5.2, 2.5], [5.2, 15.3, 3.4], [2.5, 3.4, 19.0]]) * 1e-5
    motor, link = 0.14 * 0.2**2, 2.14 * (inertials[2].centre[2] - 0.1) ** 2 - 0.14 * (0.3 - 0.1) ** 2
    there = inertials[2].tensor - np.diag([0.02, 0.02, 0.01])
    there[0, 0] += link
    there[1, 1] += link
    principal = np.linalg.eigvalsh(there)
    assert motor > 0.0
    assert principal[2] == pytest.approx(principal[0] + principal[1], rel=1e-9)
    assert np.abs(there - given).max() < 5.8e-6
    np.testing.assert_allclose(inertials[1].tensor, np.diag([0.02, 0.02, 0.01]))
    file.write_text(text.replace('izz="0.00019"', 'izz="0.0001900"'))
    with pytest.raises(ZygosError, match="link grip_motor has the principal moments"):
        read_chain(file)


def test_what_is_not_used_is_said(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    said = '<dynamics damping="3" friction="0.5"/><limit effort="1" velocity="1"/>'
    file.write_text(SOUND.replace('<axis xyz="0 0 2"/>', said))
    chain, _ = read_chain(file)
    assert chain.hinges[1].axis == (1.0, 0.0, 0.0)  # URDF's default
    assert "two (damping 3, friction 0.5)" in " ".join(chain.notes)
    assert "<limit> is not used, because arm.toml has no limits: two" in chain.notes


# --- from base parameters


def near(cad: Model, rng: np.random.Generator, relative: float = 0.01) -> Model:
    """Another arm of the same lengths; its centres lie off the lines."""

    def moved(body: Body) -> Body:
        x, y, z = np.array(body.origin_xyz) + relative * rng.normal(size=3)
        inertia = tuple(Quantity(entry.value * (1 + relative * rng.normal())) for entry in body.inertia)
        return replace(body, mass=Quantity(body.mass.value * (1 + relative * rng.normal())), origin_xyz=(x, y, z),
                       inertia=inertia)  # fmt: skip

    return replace(cad, bodies=tuple(moved(body) for body in cad.bodies), effects=())


@pytest.fixture(scope="module")
def gap() -> tuple[Arm, Model]:
    return replace(load_arm(GAP / "arm.toml"), kinetic="planar"), load_model(GAP / "cad.toml")


@pytest.mark.slow
def test_the_nearest_bodies_have_the_parameters_and_none_are_nearer(gap: tuple[Arm, Model]) -> None:
    """Against SLSQP, which shares nothing with Gauss-Newton but the conversion."""
    arm, cad = gap
    parameters = near(cad, np.random.default_rng(1), 0.1).base_parameters(arm)
    found = nearest_bodies(arm, cad, Model("given", parameters=parameters))
    wanted = np.array([quantity.value for quantity in parameters.values()])
    np.testing.assert_allclose(found.model.base_values(arm), wanted, rtol=1e-9, atol=1e-9 * wanted.max())

    units = (np.array([entries_of(body) for body in found.model.bodies]) - [entries_of(b) for b in cad.bodies]).ravel()
    moved = found.moved.ravel()
    scale = np.divide(units, moved, out=np.ones_like(units), where=np.abs(moved) > 1e-6)
    inside = np.flatnonzero(np.abs(moved) > 1e-6)  # entries out of the plane stay
    assert 8 <= len(inside) <= 12
    start = np.array([entries_of(body) for body in cad.bodies]).ravel()

    def base(y: np.ndarray) -> np.ndarray:
        rows = start.copy()
        rows[inside] += scale[inside] * y
        bodies = tuple(
            replace(body, mass=Quantity(row[0]), origin_xyz=tuple(row[1:4]), inertia=tuple(map(Quantity, row[4:])))
            for body, row in zip(found.model.bodies, rows.reshape(-1, 10), strict=True)
        )
        return (replace(found.model, bodies=bodies).base_values(arm)[:9] - wanted[:9]) / wanted[:6].mean() * 1e2

    best = minimize(
        lambda y: y @ y,
        np.zeros(len(inside)),
        jac=lambda y: 2 * y,
        constraints={"type": "eq", "fun": base},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )
    assert best.success
    assert moved @ moved == pytest.approx(best.fun, rel=1e-4)


@pytest.mark.slow
def test_determined_is_what_no_drawing_can_change(gap: tuple[Arm, Model]) -> None:
    """Two drawings that trust other numbers: entries that the parameters determine come out alike, others do not."""
    arm, cad = gap
    rng = np.random.default_rng(1)
    for body in cad.bodies:
        assert body.mass.sigma > 0
    given = Model("given", parameters=near(cad, rng).base_parameters(arm))
    other = replace(
        near(cad, rng),
        bodies=tuple(
            replace(body, mass=replace(body.mass, sigma=float(body.mass.value * rng.uniform(0.001, 0.1))))
            for body in near(cad, rng).bodies
        ),
    )
    first, second = nearest_bodies(arm, cad, given), nearest_bodies(arm, other, given)
    a, b = (np.array([entries_of(body) for body in found.model.bodies]) for found in (first, second))
    differ = np.abs(a - b) > 1e-9 * (1 + np.abs(a))
    assert not (differ & first.determined).any()
    assert not first.determined.any()  # of three free bodies in a plane, no entry by itself
    assert differ[:, [0, 1, 2, 9]].all()
    out_of_plane = [3, 4, 5, 6, 7, 8]
    assert first.known[:, out_of_plane].max() < 1e-9
    drawn = np.array([np.array(entries_of(body))[out_of_plane] for body in cad.bodies])
    np.testing.assert_allclose(a[:, out_of_plane], drawn, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_an_entry_that_is_a_base_parameter_is_determined(gap: tuple[Arm, Model]) -> None:
    """On the lines between the joints, an arm's centres have y = 0, whatever the drawing says of it."""
    arm, cad = gap
    symmetric = replace(arm, kinetic="planar-symmetric")
    given = Model("given", parameters=cad.base_parameters(symmetric))
    crooked = near(cad, np.random.default_rng(0), 1e-4)
    found = nearest_bodies(symmetric, crooked, given)
    assert found.determined[:, 2].all()
    np.testing.assert_allclose([body.origin_xyz[1] for body in found.model.bodies], 0.0, atol=1e-9)
    assert not np.delete(found.determined, 2, axis=1).any()


@pytest.mark.slow
def test_a_parameter_that_is_missing_constrains_nothing(gap: tuple[Arm, Model]) -> None:
    arm, cad = gap
    parameters = cad.base_parameters(arm)
    few = nearest_bodies(arm, cad, Model("few", parameters={"a11": replace(parameters["a11"], value=80000.0)}))
    assert few.model.base_parameters(arm)["a11"].value == pytest.approx(80000.0, rel=1e-9)
    assert few.known.sum() == pytest.approx(1.0)  # one equation takes away one direction


@pytest.mark.slow
def test_bodies_that_cannot_exist_are_refused(gap: tuple[Arm, Model]) -> None:
    arm, cad = gap
    parameters = cad.base_parameters(arm)
    wrong = parameters | {"a22": replace(parameters["a22"], value=-100.0)}
    with pytest.raises(Undecided, match="remedy"):
        nearest_bodies(arm, cad, Model("wrong", parameters=wrong))
    with pytest.raises(ZygosError, match="unknown"):
        nearest_bodies(arm, cad, Model("other", parameters={"a33": Quantity(1.0)}))


@pytest.mark.slow
def test_the_examples_arm_is_read_by_pinocchio_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "arm"
    import_urdf(EXAMPLE / "arm.urdf", out, None, None, EXAMPLE / "answers.toml", None, "-")
    text = (EXAMPLE / "arm.urdf").read_text()
    assert_the_same_robot(pin_of_urdf(text, []), pin_of_import(out), np.random.default_rng(0))
    arm = load_arm(out / "arm.toml")
    assert arm.spatial and arm.free and arm.n == 7
    assert [joint.gear_ratio for joint in arm.joints] == [160, 160, 160, 160, 120, 120, 100]
    save_model(load_model(out / "model.toml"), tmp_path / "again.toml")
    assert numbers(arm.joints[0].frame_rpy) == "0.0 0.5235987755982988 0.0"


@pytest.mark.slow
def test_bodies_of_an_arm_in_space_come_back_from_its_base_parameters() -> None:
    """Of three joints, one body heavier and turned about: bodies near the drawing have the same matrix N."""
    arm, cad = load_arm(SPATIAL / "arm.toml"), load_model(SPATIAL / "model.toml")
    last = cad.bodies[-1]
    heavier = replace(last, mass=Quantity(1.1 * last.mass.value), origin_xyz=(0.6, 0.01, 0.04))
    built = replace(cad, bodies=(*cad.bodies[:-1], heavier))
    found = nearest_bodies(arm, cad, Model("given", parameters=built.base_parameters(arm)))
    true = built.base_values(arm)
    np.testing.assert_allclose(found.model.base_values(arm), true, atol=1e-7 * sizes(arm, true).max())
    assert np.abs(found.moved).max() > 0.01
    # what noise leaves is no arm's: there are fewer ways to build one than entries of N
    rng = np.random.default_rng(0)
    noisy = {
        name: replace(q, value=q.value + 1e-4 * scale * rng.normal())
        for (name, q), scale in zip(built.base_parameters(arm).items(), sizes(arm, true), strict=True)
    }
    with pytest.raises(Undecided, match="an estimate of a spatial arm contains noise"):
        nearest_bodies(arm, cad, Model("noisy", parameters=noisy))
