# SPDX-License-Identifier: MIT
"""The C library from Python: the same code that flies, called through cffi in ABI mode.

A whole recording passes in one call. The declarations are made of ``zygos.h`` itself (`tools/build_native.py`); a
digest of them and the sizes of all public structs guard against a library that was built from other headers.
"""

from __future__ import annotations

import math
import re
import runpy
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm, Smoother
from zygos.cutoff import rate_cutoff
from zygos.effects import GAIN, Effect, with_gains
from zygos.errors import ZygosError
from zygos.runs.cycles import Cycles

_FOLDER = Path(__file__).parents[1] / "_native"

FRAME = np.dtype(
    [("id", "<u4"), ("length", "u1"), ("flags", "u1"), ("pad", "u1", (2,)), ("data", "u1", (8,))], align=False
)
"""A classical CAN frame, as ``zygos_frame_t``."""

CHANGE_ALARM = 6.0
"""Deviations that are no accident, as ``ZYGOS_CHANGE_ALARM``."""
MIN_SIGNAL_TO_NOISE = 2.0
"""Ratio of sums to noise below which only part of the noise is subtracted, as ``ZYGOS_MIN_SIGNAL_TO_NOISE``."""
MAX_REFUSED_SHARE = 0.05
"""Share of the instants that may fail the bandwidth test, as ``MAX_REFUSED_SHARE`` in solver.c."""
OVERDECLARED = 0.6
"""Share of the declared noise below which the residuals determine the noise instead, as ``ZYGOS_OVERDECLARED``."""


def _load() -> tuple[Any, Any]:
    """Load the library and compare its digest and struct sizes with the declarations."""
    try:
        declared = runpy.run_path(str(_FOLDER / "declarations.py"))
        binding = declared["ffi"]
        library = binding.dlopen(str(_FOLDER / "libzygos.so"))
    except OSError as error:
        raise ZygosError(
            f"the C library is not built ({error}); remedy: run `make build`, or install the package with pip"
        ) from error
    sizes = {name: binding.sizeof(f"zygos_{name}_t") for name in ("config", "work", "estimate", "cycle", "frame")}
    sizes["work"] -= binding.sizeof("zygos_solver_t")  # it has pointers
    version = library.ZYGOS_VERSION_MAJOR_VALUE * 256 + library.ZYGOS_VERSION_MINOR_VALUE
    abi = binding.sizeof("zygos_arm_t")
    for part in (*sizes.values(), library.ZYGOS_MAX_JOINTS_VALUE, version, library.ZYGOS_LAYOUT_VALUE):
        abi = (abi ^ part) * 16777619 & 0xFFFFFFFF
    if library.zygos_declarations_digest() != declared["DIGEST"] or library.zygos_abi() != abi:
        raise ZygosError(
            f"{_FOLDER / 'libzygos.so'} was not built from {_FOLDER / 'declarations.py'}; remedy: run `make build`"
        )
    return binding, library


ffi, lib = _load()


def text_of(function: Any, value: int) -> str:
    """What one of the library's text functions (``zygos/zygos.h``) says of a value."""
    return str(ffi.string(function(value)).decode())


def _texts(enum: str, function: Any) -> tuple[str, ...]:
    """The texts of an enumeration whose values count up from 0."""
    return tuple(text_of(function, value) for value in range(len(ffi.typeof(f"enum {enum}").elements)))


VALIDITY = _texts("zygos_validity", lib.zygos_validity_text)
"""By ``enum zygos_validity``."""
REASONS = ("", *_texts("zygos_reason", lib.zygos_reason_text)[1:])
"""By ``enum zygos_reason``; empty where an estimate has none."""
ROWS = _texts("zygos_rows", lib.zygos_rows_text)[: lib.ZYGOS_KINDS_OF_ROWS]
"""Kinds of rows, each with arcs of its own, by ``enum zygos_rows``."""
CHANNELS = _texts("zygos_channel", lib.zygos_channel_text)[: lib.ZYGOS_KINDS_OF_CHANNEL]
"""Kinds of readings whose innovations are counted apart, by ``enum zygos_channel``."""
_CONFIG_ERRORS = {
    lib.ZYGOS_E_SMOOTHER: "the smoother's points, order or lag are out of range (lag must be points // 2: end-point "
    "filters are refused)",
    lib.ZYGOS_E_VALUE: "a ratio, sign, zero, sigma, latch delay or memory is out of range",
    lib.ZYGOS_E_ARC: "arc.max_s, arc.impulse_max_s or arc.momentum_max_s is shorter than 20 cycles, or "
    "joint_rows.increment_s is shorter than 8 cycles, or than twice the joints and 4 more",
}
"""Where the arm file has other names than the configuration that is made of it."""


def _field_names(struct: str) -> tuple[str, ...]:
    return tuple(name for name, _ in ffi.typeof(struct).fields)


@dataclass(frozen=True)
class Trace:
    """What each room made of each cycle: n cycles of an arm with N joints and p parameters, effects included."""

    cycles: Cycles
    """The cycles that the receiver completed."""
    instant: NDArray[np.bool_]
    """(n,) whether the cycle completed an instant with a row."""
    accepted: NDArray[np.bool_]
    """(n,) whether that row was accumulated."""
    state: NDArray[np.float64]
    """(n, 4N+3) smoothed q, theta, q rate, theta rate, omega; rad and rad/s. Undefined where no window was full."""
    row: NDArray[np.float64]
    """(n, p+1) the columns and the work. Undefined where `instant` is false."""
    waited: NDArray[np.bool_]
    """(n, 3) whether the instant has no row of that kind, in the order of `ROWS`, because an arc waited for the one
    before it to close."""

    @classmethod
    def joined(cls, parts: Sequence[Trace]) -> Trace:
        """At least one part, one behind the other."""
        cycles = [part.cycles for part in parts]
        whole = Cycles(*(np.concatenate([getattr(one, f.name) for one in cycles]) for f in fields(Cycles)))
        others = (f.name for f in fields(cls) if f.name != "cycles")
        return cls(whole, *(np.concatenate([getattr(part, name) for part in parts]) for name in others))


@dataclass(frozen=True)
class Estimate:
    """What the C solver answers. Values and sigmas are NaN where a parameter is not identifiable."""

    names: tuple[str, ...]
    """The arm's parameters, then the columns of the effects."""
    units: tuple[str, ...]
    solution: NDArray[np.float64]
    """(p,) least squares for all columns, whatever the motion determines; NaN when refused. As a whole it predicts the
    energy of motions like those it came from."""
    value: NDArray[np.float64]
    """(p,)"""
    sigma: NDArray[np.float64]
    """(p,) one standard deviation."""
    half95: NDArray[np.float64]
    """(p,) half width of the 95 % interval."""
    covariance: NDArray[np.float64]
    """(p, p)"""
    validity: str
    reason: str
    cycle: int
    accepted: int
    refused: int
    arcs: int
    blocks: int
    rank: int
    condition: float
    cluster: float
    """How far the residuals of a block add up: around 1 for noise, up to the block's instants otherwise."""
    residual: float
    """rms of the rows' residuals, J."""
    noise_ratio: float
    """Its square over what the declared noise makes of it; NaN where none is declared."""
    signal_to_noise: float
    """Smallest ratio of sums to noise over all combinations of parameters; infinite where none is declared."""
    left_out: tuple[int, int, int] = (0, 0, 0)
    """Arcs that contradicted the running solution, of the energy, the motor and the momentum rows, the open ones
    included. Where joint rows alone determine the estimate, the first number is that of their segments."""
    since: int = 0
    """0, or older arcs spoilt the sums and only what came behind this cycle went in."""
    consecutive: int = 0
    """Of those of the energy rows the newest that no arc that agrees lies between."""

    @property
    def significance(self) -> NDArray[np.float64]:
        """(p,) |value| in standard deviations: how surely a parameter is not zero. NaN where it has no value."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.abs(self.value) / self.sigma)


@dataclass(frozen=True)
class LeftOut:
    """An arc that contradicted the running solution."""

    rows: str
    """One of `ROWS`."""
    first: int
    """Number of its first instant's cycle."""
    last: int
    """Number of its newest cycle."""


def closed_blocks(sums: Any) -> list[Any]:
    """The blocks of closed arcs in order of time, of the energy, motor or momentum rows."""
    return [sums.block[place] for place in sums.store.order[0 : sums.store.closed]]


def accepted(state: Any) -> int:
    """How many instants of the energy rows a zygos_arm_t has accepted and not dropped."""
    return int(lib.zygos_store_accepted(ffi.addressof(state.sums.energy, "store")))


@dataclass(frozen=True)
class Blocks:
    """Sums of the rows, block by block, the arcs' constants eliminated and the declared noise taken off."""

    energy: list[tuple[NDArray[np.float64], NDArray[np.float64], float, float, float]]
    """Of each block the squares of columns and work (p+1, p+1), their sums less the arcs' means (p+1,), the sums of the
    instants' shares in it and of the shares' squares, and what the noise of torques adds to the variance of the work in
    it, J^2."""
    motors: list[list[tuple[NDArray[np.float64], float]]]
    """Of each block and joint the squares of its c columns and the impulse (c+1, c+1), and the instants."""
    momentum: list[NDArray[np.float64]]
    """Of each block the squares of the columns (K+N, K+N)."""
    joints: list[tuple[NDArray[np.float64], float]]
    """Of each group of joint rows the squares of columns and impulse (p+1, p+1), and the number of rows."""


@dataclass(frozen=True)
class Drift:
    """The newest arc against the running solution."""

    names: tuple[str, ...]
    deviation: NDArray[np.float64]
    """(p,) how far the newest arc's own value lies from the running solution's, in standard deviations of the
    difference; NaN where the arc does not tell, or nothing was compared."""
    reason: str
    """Why nothing was compared, or why a deviation proves no change: the balance does not close; or empty."""
    until: int
    """Number of the newest cycle before this arc."""

    @property
    def largest(self) -> float:
        """The largest deviation; 0 where nothing could be compared."""
        return float(np.abs(np.nan_to_num(self.deviation)).max(initial=0.0))

    @property
    def changed(self) -> tuple[str, ...]:
        """Parameters that have changed: they contradict, and the balance closes before and after."""
        return () if self.reason else self.contradicting

    @property
    def contradicting(self) -> tuple[str, ...]:
        """Parameters whose value in the newest arc contradicts what was known before, whatever the cause."""
        far = np.abs(np.nan_to_num(self.deviation)) >= CHANGE_ALARM
        return tuple(name for name, there in zip(self.names, far, strict=True) if there)


WINDOW_MAX: int = 2 * lib.ZYGOS_MAX_HALF_WIDTH_VALUE + 1
"""Points of the longest window of the smoother in this build of the C library."""


def fits_window(arm: Arm) -> bool:
    """Whether this build of the C library holds the window of the arm's smoother."""
    return arm.smoother.points <= WINDOW_MAX


def longer_period(arm: Arm) -> str:
    """The remedy for an arm whose window is too long: the period at which one of the same cut-off fits."""
    own = arm.smoother
    cutoff = own.cutoff_hz or rate_cutoff(own.points // 2, own.order) / arm.period_s
    shortest = rate_cutoff(lib.ZYGOS_MAX_HALF_WIDTH_VALUE, 4) / cutoff
    return f"a period_s of at least {math.ceil(1e5 * shortest) / 1e5:.5g} for the cut-off of {cutoff:.3g} Hz"


def receivable(arm: Arm) -> Arm:
    """The arm as the receiver and the encoder of frames see it, in which the smoother has no part."""
    return arm if fits_window(arm) else replace(arm, smoother=Smoother())


def config_of(arm: Arm, effects: Sequence[Effect] = ()) -> Any:
    """Translate an arm description, and the effects whose coefficients are to be found, into ``zygos_config_t *``.

    Errors: ZygosError for what has no columns in this build.
    """
    if arm.n > lib.ZYGOS_MAX_JOINTS_VALUE:
        raise ZygosError(
            f"arm {arm.name!r} has {arm.n} joints, this build holds {lib.ZYGOS_MAX_JOINTS_VALUE}; "
            "remedy: rebuild with -DZYGOS_MAX_JOINTS"
        )
    if not fits_window(arm):
        half = arm.smoother.points // 2
        raise ZygosError(
            f"arm {arm.name!r} has a smoother of {arm.smoother.points} points, this build holds {WINDOW_MAX}; "
            f"remedy: {longer_period(arm)}, or rebuild with -DZYGOS_MAX_HALF_WIDTH={half}"
        )
    laws = {"applied_from_sync": 0, "applied_previous_cycle": 1, "sampled": 2}
    kinetics = {"planar-symmetric": 0, "planar": 1, "spatial": 2}
    config = ffi.new("zygos_config_t *")
    config.abi = lib.zygos_abi()
    config.joints = arm.n
    config.kinetic = kinetics[arm.kinetic]
    config.base = 0 if arm.free else 1
    config.gravity = arm.gravity
    config.torque_law = laws[arm.torque_law]
    config.smoother_half_width = arm.smoother.points // 2
    config.smoother_order = arm.smoother.order
    config.smoother_lag = arm.smoother.lag
    config.arc_cycles = max(1, round(arm.arc_max_s / arm.period_s))
    config.imu_node = arm.imu.node
    config.imu_fine = int(arm.imu.resolution == "fine")
    config.period_s = arm.period_s
    for k, entry in enumerate(np.asarray(arm.mount, dtype=float).ravel()):
        config.imu_to_base[k] = entry
    config.imu_latch_s = arm.imu.latch_us * 1e-6
    config.imu_sigma = arm.imu.over_the_wire.rate_sigma
    config.forgetting_factor = 1.0 if arm.memory_s is None else math.exp(-arm.period_s / arm.memory_s)
    config.compensation = arm.compensation
    config.impulse_arc_cycles = max(1, round(arm.impulse_arc_s / arm.period_s)) if arm.impulse_arc_s > 0.0 else 0
    config.momentum_arc_cycles = max(1, round(arm.momentum_arc_s / arm.period_s)) if arm.momentum_arc_s > 0.0 else 0
    config.joint_row_cycles = 2 * max(1, round(0.5 * arm.joint_row_s / arm.period_s)) if arm.joint_row_s > 0.0 else 0
    if config.joint_row_cycles > 0 and not lib.ZYGOS_JOINT_ROWS_VALUE:
        raise ZygosError(
            f"arm {arm.name!r} wants joint rows, this build has no room for them; "
            "remedy: increment_s = 0 in [joint_rows], or rebuild with -DZYGOS_JOINT_ROWS=1"
        )
    if config.momentum_arc_cycles > 0 and not lib.ZYGOS_MOMENTUM_VALUE:
        raise ZygosError(
            f"arm {arm.name!r} wants momentum rows, this build has no room for them; "
            "remedy: momentum_max_s = 0 in [arc], or rebuild with -DZYGOS_MOMENTUM=1"
        )
    _fill_joints(config, arm)
    _fill_reduction(config, arm)
    _refuse_unflown(arm, effects)
    columns = with_gains(arm, effects)
    if len(columns) > lib.ZYGOS_MAX_EFFECTS_VALUE:
        raise ZygosError(
            f"{len(columns)} effects are to be estimated, this build holds {lib.ZYGOS_MAX_EFFECTS_VALUE}; "
            "remedy: keep those that matter most (a joint with zero_sigma_rad > 0 has one), or rebuild with "
            "-DZYGOS_MAX_EFFECTS"
        )
    config.effects = len(columns)
    for k, effect in enumerate(columns):
        config.effect[k].kind = getattr(lib, f"ZYGOS_{effect.kind.key.upper()}")
        config.effect[k].joint = effect.index(arm)
    return config


def _refuse_unflown(arm: Arm, effects: Sequence[Effect]) -> None:
    """Refuse effects that the library has no columns for, naming them all."""
    lacking = [effect for effect in effects if not (effect.kind.flies or effect.kind.key == GAIN)]
    exact = [e.joint for e in effects if e.kind.key == GAIN and e.index(arm) not in arm.relative_gains]
    if exact:
        raise ZygosError(
            f"arm {arm.name!r} has no gain to find at {', '.join(map(str, exact))}: gains are relative to the joint "
            "with the most exact torque sensor, and a torque_gain_sigma of 0 declares an exact one; remedy: a larger "
            "torque_gain_sigma in the arm file, or leave the entry out"
        )
    if lacking:
        listed = [f"{effect.kind.key}{f' at {effect.joint}' if effect.joint else ''}" for effect in lacking]
        these, them = ("this entry", "it") if len(lacking) == 1 else ("these entries", "them")
        raise ZygosError(
            f"the flight library has no column for {', '.join(listed)}; remedy: remove {these} from a copy of the "
            f"model, and use that; the estimate then lacks {them}, and parameters that resemble {them} are biased"
        )


def _fill_joints(config: Any, arm: Arm) -> None:
    """Write what the arm file says of the joints into the configuration."""
    for i, joint in enumerate(arm.joints):
        out = config.joint[i]
        out.node = joint.node
        out.latch_us = joint.latch_us
        out.rigid = int(not joint.flexible)
        # the bodies of a planar arm have the base's frame in its stretched posture
        out.axis = list(joint.axis if arm.spatial else arm.axis)
        if arm.spatial:
            out.frame = (arm.frames[i].T @ arm.frames[i + 1]).ravel().tolist()
        out.gear_ratio = arm.gear_ratios[i]
        declared = joint.torque_sigma > 0.0
        out.torque_sigma = out.gear_ratio * joint.over_the_wire.torque_sigma if declared else 0.0
        out.torque_relative_sigma = joint.torque_relative_sigma
        out.torque_gain_sigma = joint.torque_gain_sigma
        link, motor = joint.link_encoder.over_the_wire, joint.motor_encoder.over_the_wire
        out.link_sign, out.link_zero_rad, out.link_sigma_rad = link.sign, link.zero_rad, link.sigma_rad
        out.motor_sign, out.motor_zero_rad, out.motor_sigma_rad = motor.sign, motor.zero_rad, motor.sigma_rad
        out.link_latch_s, out.motor_latch_s = link.latch_us * 1e-6, motor.latch_us * 1e-6


def _fill_reduction(config: Any, arm: Arm) -> None:
    """Write the basis of the arm's structure into the configuration. Errors: ZygosError if the build has no room."""
    structure = arm.structure
    if not structure.reduces:
        return
    columns, parameters = np.nonzero(structure.basis)
    if len(columns) > len(config.reduction):
        raise ZygosError(
            f"arm {arm.name!r}: the reduction to its {structure.size} independent parameters has {len(columns)} "
            f"entries, this build holds {len(config.reduction)}; remedy: rebuild with "
            f"-DZYGOS_MAX_REDUCTION={len(columns)}, or leave position_m out of the arm file"
        )
    config.reduced, config.reductions = structure.size, len(columns)
    for entry, column, parameter in zip(config.reduction, columns.tolist(), parameters.tolist(), strict=False):
        entry.column, entry.parameter, entry.factor = column, parameter, structure.basis[column, parameter]


def cycles_to_native(cycles: Cycles) -> Any:
    """Pack cycles into an array of ``zygos_cycle_t``, owned by the caller."""
    n, joints = cycles.q.shape
    array = ffi.new("zygos_cycle_t[]", max(n, 1))
    width = ffi.sizeof("zygos_cycle_t") // 8
    table = np.frombuffer(ffi.buffer(array), dtype=np.float64).reshape(-1, width)
    integers = table.view(np.uint64)
    capacity = lib.ZYGOS_MAX_JOINTS_VALUE
    integers[:n, 0] = cycles.sync
    integers[:n, 1] = cycles.flags.astype(np.uint64)
    for block, values in enumerate((cycles.q, cycles.theta, cycles.tau)):
        table[:n, 2 + block * capacity : 2 + block * capacity + joints] = values
    table[:n, 2 + 3 * capacity : 5 + 3 * capacity] = cycles.omega
    return array


def encode(arm: Arm, cycles: Cycles) -> NDArray[Any]:
    """Encode cycles as the frames of a bus, `FRAME` records in the order of transmission.

    Each cycle is SYNC, FTIME (every 50th cycle), angles and torque of each joint, and the gyro; one SYNC at the end
    closes the last cycle. Values outside the wire's ranges saturate, as a drive's would.
    """
    n = len(cycles)
    frames = np.zeros(n * (4 + 2 * arm.n) + 1, dtype=FRAME)
    out = ffi.cast("zygos_frame_t *", frames.ctypes.data)
    used = lib.zygos_batch_encode(config_of(receivable(arm)), cycles_to_native(cycles), n, out)
    return frames[:used]


def _symmetric(packed: Any, size: int) -> NDArray[np.float64]:
    """The matrix whose lower triangle stands row by row in an array of the library's."""
    out = np.zeros((size, size))
    rows, columns = np.tril_indices(size)
    out[rows, columns] = np.frombuffer(ffi.buffer(packed), dtype=np.float64)[: len(rows)]
    out[columns, rows] = out[rows, columns]
    return out


class Flight:
    """One arm in the C library: frames or cycles in, estimates out."""

    def __init__(self, arm: Arm, effects: Sequence[Effect] = ()) -> None:
        """Initialise ``zygos_arm_t`` for an arm and the effects to find; their values play no part.

        Raises ZygosError when the library refuses the configuration, or has no columns for an effect.
        """
        self.arm = arm
        self.native = ffi.new("zygos_arm_t *")
        verdict = lib.zygos_arm_init(self.native, config_of(arm, effects))
        if verdict < 0:
            reason = _CONFIG_ERRORS.get(verdict) or text_of(lib.zygos_text, verdict)
            raise ZygosError(
                f"the flight library refuses arm {arm.name!r}: {reason}; "
                f"remedy: correct the {'effects' if verdict == lib.ZYGOS_E_EFFECT else 'arm file'}"
            )
        self.effects = with_gains(arm, effects)
        own = arm.parameters
        self.names = (*(one.name for one in own), *(effect.column(arm) for effect in self.effects))
        if self.native.sums.column_map.parameters != len(self.names):
            raise ZygosError(
                f"arm {arm.name!r}: gravity is within 1e-9 rad of a joint axis, which may or may not feel it; "
                "remedy: make them parallel, or tilt them"
            )
        self.units = (*(one.unit for one in own), *(effect.kind.unit for effect in self.effects))
        self._work = ffi.new("zygos_work_t *")
        self._estimate = ffi.new("zygos_estimate_t *")
        drives = [first + joint.node for joint in arm.joints for first in (0x180, 0x280)]
        self._own = np.array([0x080, 0x3A0, *drives, *(first + arm.imu.node for first in (0x180, 0x380))])
        self.fd_frames = 0
        """Frames of CAN FD with an identifier of the arm, which the library ignores without counting them."""

    def frames(self, frames: NDArray[Any], *, trace: bool = False) -> Trace | None:
        """Feed `FRAME` records and work off every cycle they complete."""
        frames = np.ascontiguousarray(frames, dtype=FRAME)
        pointer = ffi.cast("zygos_frame_t *", frames.ctypes.data)
        table = (
            _TraceTable(self.arm, len(self.names), int(np.count_nonzero(frames["id"] == 0x080)) + 1) if trace else None
        )
        fd = frames["id"][(frames["flags"] & lib.ZYGOS_FRAME_FD) > 0]
        self.fd_frames += int(np.count_nonzero(np.isin(fd, self._own)))
        lib.zygos_batch_frames(self.native, pointer, len(frames), ffi.NULL, table.native if table else ffi.NULL)
        return table.trace() if table else None

    def cycles(self, cycles: Cycles, *, trace: bool = False) -> Trace | None:
        """Feed cycles in SI through the other door."""
        table = _TraceTable(self.arm, len(self.names), len(cycles)) if trace else None
        native = cycles_to_native(cycles)
        lib.zygos_batch_cycles(self.native, native, len(cycles), table.native if table else ffi.NULL)
        return table.trace() if table else None

    def _solve(self) -> None:
        """Solve a copy of the sums."""
        lib.zygos_arm_take(self.native, self._work)
        lib.zygos_work_solve(self._work, self._estimate)

    def estimate(self) -> Estimate:
        """Take and solve. The accumulation is not disturbed."""
        self._solve()
        out, p = self._estimate, self._estimate.parameters
        return Estimate(
            names=self.names,
            units=self.units,
            solution=np.frombuffer(ffi.buffer(out.solution), dtype=np.float64)[:p].copy(),
            value=np.frombuffer(ffi.buffer(out.value), dtype=np.float64)[:p].copy(),
            sigma=np.frombuffer(ffi.buffer(out.sigma), dtype=np.float64)[:p].copy(),
            half95=np.frombuffer(ffi.buffer(out.half95), dtype=np.float64)[:p].copy(),
            covariance=_symmetric(out.covariance, p),
            validity=VALIDITY[out.validity],
            reason=REASONS[out.reason],
            cycle=out.cycle,
            accepted=out.accepted,
            refused=out.refused,
            arcs=out.arcs,
            blocks=out.blocks,
            rank=out.rank,
            condition=out.condition,
            cluster=out.cluster,
            residual=out.residual,
            noise_ratio=out.noise_ratio,
            signal_to_noise=out.signal_to_noise,
            left_out=(out.left_out[0], out.left_out[1], out.left_out[2]),
            since=int(out.since),
            consecutive=int(out.consecutive),
        )

    @property
    def joints_alone(self) -> bool:
        """Whether joint rows alone determine the estimate; their segments then have the place of energy arcs."""
        return bool(lib.zygos_joint_sums_suffice(ffi.addressof(self.native, "sums", "config")))

    def adopt(self) -> bool:
        """Take what `estimate` answered last as the running solution, if it is valid.

        An arc that contradicts the running solution when it ends is left out of the sums and counted.
        """
        return bool(lib.zygos_arm_adopt(self.native, self._estimate) == 1)

    def drift(self) -> Drift:
        """Compare the newest arc with the running solution that was adopted. The accumulation is not disturbed."""
        self._solve()
        return self.compared()

    def compared(self) -> Drift:
        """The comparison of the newest arc that the last `estimate` made beside its values."""
        out, p = self._work.solver.newest, len(self.names)
        far = np.frombuffer(ffi.buffer(out.deviation), dtype=np.float64)[:p].copy()
        return Drift(self.names, far, REASONS[out.reason], int(out.until))

    def restart(self, *, keep_joints: bool = False, keep_faults: bool = True) -> None:
        """Start the estimate from nothing, or from what is known of Im, k and b. Errors: ZygosError if nothing is."""
        keep = int(keep_faults) * lib.ZYGOS_KEEP_FAULTS + int(keep_joints) * lib.ZYGOS_KEEP_JOINTS
        if lib.zygos_arm_restart(self.native, keep) < 0:
            raise ZygosError(
                f"arm {self.arm.name!r} has no motor rows that could be kept; remedy: [arc] impulse_max_s above 0"
            )

    def _total(self) -> NDArray[np.float64]:
        """Sums of all closed energy rows [columns, work, 1], (p+2, p+2)."""
        sums = self._closed()
        none = np.zeros((sums.width, sums.width))
        return sum((block.head.fade * _symmetric(block.gram, sums.width) for block in closed_blocks(sums)), start=none)

    def normal_equations(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A (p, p) and b (p,) with the arc constants eliminated and the declared noise taken off."""
        full = self._total()
        p = len(full) - 2
        return full[:p, :p].copy(), full[p, :p].copy()

    def unexplained(self, result: Estimate) -> float:
        """Share of the work's variance about the arc constants that an estimate leaves over; where joint rows alone are
        solved, of the impulses' mean square. NaN without work."""
        lib.zygos_arm_take(self.native, self._work)
        lib.zygos_work_solve(self._work, self._estimate)
        if self._work.solver.joints_alone:
            whole = float(self._work.solver.spread)
            return result.residual**2 * float(self._work.solver.instants) / whole if whole > 0.0 else float("nan")
        spread = float(self._total()[-2, -2])
        return result.residual**2 * result.accepted / spread if spread > 0.0 else float("nan")

    def noise(self) -> NDArray[np.float64]:
        """What the declared noise adds on average to the squares of columns and work, (p+1, p+1)."""
        sums = self._closed()
        return float(sums.store.noise_fade) * _symmetric(sums.noise_closed.gram, sums.width - 1)

    def blocks(self) -> Blocks:
        """The blocks behind the sigmas, the open arcs ended; not weighed."""
        self._solve()  # ends the open arcs of the copy
        sums, joints, momenta = self._work.sums.energy, self._work.sums.motors, self._work.sums.momentum
        rows = self._work.sums.joints
        pointer, width = ffi.addressof(sums), len(self.names) + 1
        return Blocks(
            energy=[
                (
                    _symmetric(block.gram, width),
                    np.array(list(lib.zygos_accumulator_deviation(pointer, ffi.addressof(block))[0:width])),
                    block.head.total,
                    block.square,
                    block.variance[0],
                )
                for block in closed_blocks(sums)
            ],
            motors=[
                [
                    (_symmetric(block.joint[i].gram, joints.column_map.count[i] + 1), block.instants[i])
                    for i in range(self.arm.n)
                ]
                for block in closed_blocks(joints)
            ],
            momentum=[_symmetric(block.rows.gram, momenta.columns) for block in closed_blocks(momenta)],
            joints=[
                (rows.fade[g] * _symmetric(rows.group[g].gram, width), rows.fade[g] * rows.count[g])
                for g in range(len(rows.group) - 1)  # the last one is not of the estimate
                if rows.width > 0
            ],
        )

    def _closed(self) -> Any:
        """A copy of the sums whose arcs have ended, also one that waits for that."""
        lib.zygos_arm_take(self.native, self._work)
        lib.zygos_sums_end_copy(ffi.addressof(self._work, "sums"))
        return ffi.addressof(self._work.sums, "energy")

    @property
    def left_out(self) -> tuple[int, tuple[LeftOut, ...]]:
        """How many arcs that have ended were left out, and the newest of them, oldest first."""
        guard = self.native.sums.guard
        count, places = sum(guard.left_out), len(guard.newest)
        arcs = [guard.newest[k % places] for k in range(max(0, count - places), count)]
        return count, tuple(LeftOut(ROWS[a.rows], int(a.end) - a.cycles + 1, int(a.end)) for a in arcs)

    @property
    def faults(self) -> dict[str, int]:
        """Counter of every kind of fault of the world."""
        counters = self.native.receiver.faults
        return {name: int(getattr(counters, name)) for name in _field_names("zygos_faults_t")}

    @property
    def counts(self) -> dict[str, int]:
        """Cycles worked off, gaps between them, arcs and instants."""
        sums = self.native.sums.energy
        return {
            "cycles": int(self.native.cycles),
            "gaps": int(self.native.gaps),
            "invalid": int(self.native.invalid),
            "wraps": int(self.native.wraps),
            "apart": int(self.native.apart),
            "waited": sum(self.native.waited),
            "arcs_dropped": int(sums.store.arcs_dropped),
            "accepted": accepted(self.native),
            "refused": int(sums.refused),
        }


class _TraceTable:
    """Arrays that the library writes a trace into."""

    def __init__(self, arm: Arm, p: int, capacity: int) -> None:
        n = arm.n
        self.arm = arm
        self.arrays: dict[str, NDArray[Any]] = {
            "sync": np.zeros(capacity, np.uint64),
            "flags": np.zeros(capacity, np.uint32),
            "instant": np.zeros(capacity, np.uint8),
            "waited": np.zeros(capacity, np.uint8),
            "accepted": np.zeros(capacity, np.uint8),
            "measured": np.zeros((capacity, 3 * n + 3)),
            "state": np.zeros((capacity, 4 * n + 3)),
            "row": np.zeros((capacity, p + 1)),
        }
        self.native = ffi.new("zygos_trace_t *")
        self.native.capacity = capacity
        for name, array in self.arrays.items():
            kind = re.sub(r"\[\d+\]$", "", str(ffi.typeof(getattr(self.native, name)).cname))
            setattr(self.native, name, ffi.cast(kind, array.ctypes.data))

    def trace(self) -> Trace:
        used = {name: array[: self.native.count] for name, array in self.arrays.items()}
        n = self.arm.n
        q, theta, tau, omega = np.split(used["measured"], [n, 2 * n, 3 * n], axis=1)
        cycles = Cycles(sync=used["sync"], q=q, theta=theta, tau=tau, omega=omega, flags=used["flags"])
        instant, accepted = (used[name] > 0 for name in ("instant", "accepted"))
        waited = (used["waited"][:, None] >> np.arange(len(ROWS)) & 1) > 0
        return Trace(cycles, instant, accepted, used["state"], used["row"], waited)
