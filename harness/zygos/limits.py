# SPDX-License-Identifier: MIT
"""All limits that decide: thresholds and settings of `explain`, of estimates on the ground, of audits and refinement.

docs/reference/limits.md is made from this table, and an answer in JSON lists those that decided it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from zygos.quantiles import normal_isf

Source = Literal["convention", "derived", "trial"]
"""Where a value is from: chosen as usual in the field, or by purpose; computed from something else; or set in trials
with runs whose truth is known (docs/trials.md)."""
Number = TypeVar("Number")


@dataclass(frozen=True)
class Limit(Generic[Number]):
    """A threshold or a setting."""

    name: str
    value: Number
    unit: str
    """1 where it has none."""
    source: Source
    meaning: str


# fmt: off

# Conversion
OUTLIER = Limit("outlier", 10.0, "1", "convention",
    "A sample lies off, or a step is none of the motion, by more than so many times of what varies around it.")
OUTLIER_WINDOW = Limit("outlier window", 12, "1", "convention",
    "Samples on each side whose second differences say what varies.")
OUTLIER_BURST = Limit("outlier burst", 4, "1", "convention",
    "Samples next to each other that may lie off.")
OUTLIERS_MANY = Limit("outliers many", 0.005, "1", "convention",
    "Share of samples that lie off from which on others next to them do as well.")
TURN_NEAR = Limit("turn near", 0.05, "1", "convention",
    "Share by which a step may differ from a turn of the angle, or from another number at which it starts again.")
TURN_SURE = Limit("turn sure", 0.4, "1", "convention",
    "Share of a turn, or of another number at which an angle starts again, that it may move between two samples.")
SECOND_SOURCE = Limit("second source", 0.05, "1", "convention",
    "Share of samples that lie off above which a second source seems to send them, and the recording is refused.")
NOISE_ADDED = Limit("noise added", 5.0, "1", "convention",
    "Noise that the conversion adds, in units of that of the sensor, from which a warning names its cause.")

# The gate
NOT_WORSE = Limit("not worse", 1.1, "1", "trial",
    "Error of a model's predictions over that of the best baseline, up to which it is no worse.")
LEAST_INERTIA = Limit("least inertia", 1e-300, "kg m^2, Nm/rad", "derived",
    "Smallest inertia and stiffness: equations of motion are divided by them.")
LEAST_GAIN = Limit("least gain", -0.9, "1", "convention",
    "Smallest gain of a sensor: at -1 what it reads is multiplied by zero, and nothing is left to explain.")
CLOSED = Limit("closed", 3.0, "1", "trial",
    "Error of the predictions of an untouched run over that of noise up to which the run closes.")
PLAIN_LEAVES = Limit("plain leaves", 0.5, "1", "trial",
    "Share of the error of the model as delivered that the plain estimate leaves where it is an answer by itself.")
PLAIN_WRONG = Limit("plain wrong", 0.25, "1", "convention",
    "Share of the work, or of the torques, of an untouched run that it may then predict wrongly.")
STRETCH_S = Limit("stretch s", 0.5, "s", "convention",
    "Length of the stretches over which errors are compared.")
CLOSED_TORQUES = Limit("closed torques", 5.0, "1", "trial",
    "The same where offsets or gains of the torques are taken from the runs: they are not exact, and their errors "
    "alone have reached three.")
CLOSED_BALANCE = Limit("closed balance", 1.5, "1", "trial",
    "Residual of a balance over that of its simulated twin up to which nothing is missing.")
EVALUATED = Limit("evaluated", 5.0, "1", "convention",
    "Torque of a joint over its floor from which on its prediction is evaluated: below, its error says little of a "
    "model.")
WORK_WINDOW_S = Limit("work window s", 1.0, "s", "convention",
    "Time over which works are compared.")

PREDICTED_READINGS = Limit("predicted readings", 50_000, "1", "convention",
    "Readings in the stretches of a run that a model predicts half a second ahead: about so many, evenly spread.")
PREDICTED_DRAWS = Limit("predicted draws", 24, "1", "convention",
    "Draws of the noise that give the covariance of these predictions.")

# What differs, and what is significant
INTERVAL_Z = Limit("interval z", float(normal_isf(0.025)), "1", "convention",
    "Standard deviations of a 95 % interval.")
CONFIDENCE = Limit("confidence", 0.95, "1", "convention",
    "Probability of the intervals of an answer.")
SURE_CONFIDENCE = Limit("sure confidence", 0.997, "1", "convention",
    "Probability of the interval that a value which no arm can have must not reach.")
TAIL_PERCENT = Limit("tail percent", 90, "%", "convention",
    "Percentile of the errors of predictions that is compared beside their median.")
DIFFERS_Z = Limit("differs z", 3.0, "1", "convention",
    "Standard deviations by which a value differs from the simulation's.")
DISAGREE_Z = Limit("disagree z", 4.5, "1", "trial",
    "Standard deviations by which the runs may not disagree on a value.")
MATERIAL_DIFFERENCE = Limit("material difference", 0.005, "1", "convention",
    "Share of a value below which a difference does not matter.")
NAMED_Z = Limit("named z", 4.5, "1", "trial",
    "Standard deviations that a candidate needs at least, whatever draws of noise say: models are not perfect.")
FALSE_ALARMS = Limit("false alarms", 0.001, "1", "convention",
    "Probability with which noise alone makes a search name something.")
NULL_DRAWS = Limit("null draws", 500, "1", "convention",
    "Searches on noise alone that give the limit of a search.")

# The search in space
AGREE_SHARE = Limit("agree share", 0.25, "1", "trial",
    "Share by which the coefficients of single runs, and that of all runs together, may differ: a law that differs "
    "in form from its column has no one size.")
STEADY_SHARE = Limit("steady share", 0.05, "1", "trial",
    "Share by which the coefficients of single runs may differ beyond noise where the law is said to be exactly "
    "that of its column.")
AGREE_Z = Limit("agree z", 4.0, "1", "convention",
    "Standard deviations by which the coefficients of single runs may differ in any case.")
EXCESS = Limit("excess", 0.2, "1", "trial",
    "A balance has something to explain where rho^2 - 1 is above this and above what its twin itself varies by.")
EXCESS_Z = Limit("excess z", 4.0, "1", "convention",
    "Standard deviations of the twin's rho^2 that an excess must exceed.")
COMPLETE = Limit("complete", 0.95, "1", "trial",
    "Share of the excess that a set of effects must take away to bear their names.")
REST = Limit("rest", 0.8, "1", "trial",
    "Share of what is left over that an effect must take away to be named after the set is complete: a small effect "
    "beside a large one, but not the part of a large one's law that its column lacks.")
PROMISING = Limit("promising", 0.8, "1", "trial",
    "Share of all that is left over that two candidates must take away to be compared run by run.")
PARTLY = Limit("partly", 0.6, "1", "trial",
    "Share of the excess that a set must take away for a part of something unknown to be described by it.")
MOST_EFFECTS = Limit("most effects", 4, "1", "convention",
    "Effects that are looked for.")
POLISHES = Limit("polishes", 2, "1", "trial",
    "Grids of shapes that are tried one after the other in any case.")
MOST_POLISHES = Limit("most polishes", 5, "1", "trial",
    "Grids of shapes that are tried one after the other at most.")
LATE_ENTRIES = Limit("late entries", 8, "1", "trial",
    "Entries of the catalogue that are searched last: those judged in each round, which explain most by themselves.")
LATE_SHAPES = Limit("late shapes", 2, "1", "trial",
    "Shapes of each of those entries that are judged.")
LATE_PAIRS = Limit("late pairs", 6, "1", "trial",
    "Pairs of those entries that are judged, which explain most together.")
CONTENDERS = Limit("contenders", 3, "1", "convention",
    "Entries of the catalogue that are each compared about their own model, beside what was named or in its place.")
STEP_LEAVES = Limit("step leaves", 0.5, "1", "trial",
    "Share of what is left over that one of them may leave to be taken, if all of them leave as little as is asked.")
CHANCE_Z = Limit("chance z", 1.645, "1", "convention",
    "One-sided 95 % limit of the normal distribution.")
SHAPE_GAINS = Limit("shape gains", 0.01, "1", "trial",
    "Share of the excess that a law with a shape must explain more than the law without one that it becomes.")
FINE_SHAPES = Limit("fine shapes", 7, "1", "convention",
    "Shapes of a finer grid.")
GAINS = Limit("gains", 0.05, "1", "trial",
    "Share of the excess that a further effect must take away more, while the set is not complete.")
COUPLING = Limit("coupling", (0.5, 1.5), "1", "convention",
    "Effect of a rotor's coupling as a multiple of the rotor inertia: an arm has one.")
MOSTLY = Limit("mostly", 0.8, "1", "trial",
    "Share that the named effects explain from which on nothing else is searched for.")
DOUBT = Limit("doubt", 0.6, "1", "trial",
    "Share of what the named effects leave over that another candidate may leave to cast doubt on them.")
CHANGE_LEAVES = Limit("change leaves", 0.5, "1", "trial",
    "Share of the error of predictions that a change may leave.")
CLEARLY = Limit("clearly", 1.5, "1", "trial",
    "Ratio of errors of predictions that chance does not make.")
TRIFLE = Limit("trifle", 0.01, "1", "trial",
    "Difference of completeness of two searches that says nothing.")
MOVES = Limit("moves", 0.1, "1", "trial",
    "Share of the largest value of the same unit that a value counts as at least: hardly anything moves otherwise.")
DEFLECTED_Z = Limit("deflected z", 3.0, "1", "trial",
    "Standard deviations of the encoders beyond which a joint that is said to be rigid is not.")
SKEWED = Limit("skewed", 0.95, "1", "trial",
    "Share of a deflection that goes with the joint's rate: then it is a matter of the encoders' timing.")
LATE_ALIKE = Limit("late alike", 0.05, "1", "trial",
    "Share by which the delays of all torques may differ from half a period or a whole one to be a torque law.")
USED = Limit("used", 0.9, "1", "convention",
    "Share of a run below which its losses are mentioned.")
GAIN_OFF = Limit("gain off", 0.05, "1", "convention",
    "Share by which the gain of a torque sensor may differ from that of the first joint without being an effect.")
NOISY = Limit("noisy", 5.0, "1", "trial",
    "Ratio of a residual to its twin's that unseen noise of the torques does not reach.")
REDRAWN = Limit("redrawn", 6, "1", "convention",
    "Models with redrawn values that predict the floor's twin.")
THINNED = Limit("thinned", 3, "1", "convention",
    "Every so many of the floor's stretches are predicted by them.")
STRATA = Limit("strata", (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2), "1", "convention",
    "Shares of the square of the law's torque up to which the strata reach: time near rest is short, and rows see "
    "little of it.")
REVERSAL = Limit("reversal", 1 / 16, "1", "convention",
    "The share in which what lags behind the law is looked at: there a hysteresis differs most from a law without "
    "one.")
LEFT_OUT = Limit("left out", 1e-3, "1", "convention",
    "Weight of a balance that is left out.")
LATEST = Limit("latest", 0.99, "1", "convention",
    "Delay of a torque that the model of a twin has at most, in periods.")
FAILS_ALIKE = Limit("fails alike", 1.0 / 3.0, "1", "trial",
    "Share of the worst balance's ratio from which on another balance fails about as much.")

# Twins, and errors of sensors
DRAWS = Limit("draws", 20, "1", "derived",
    "Readings of a twin: enough to know a standard deviation to 16 %.")
FEW_DRAWS = Limit("few draws", 4, "1", "trial",
    "Draws that are enough to weight the balances of a study that is made again, and to rank columns.")
DRAWN_TOGETHER = Limit("drawn together", 60_000, "1", "convention",
    "Rates of the base, times joints, in the readings of a twin that are summed at a time: what so many make fits into "
    "the cache of a processor.")
MOTION_DRAWS = Limit("motion draws", 6, "1", "convention",
    "Draws of a twin that judge a proposed motion.")
VARIANTS = Limit("variants", ((0.5, 1.0), (2.0, 1.0), (1.0, 0.5), (1.0, 1.5), (0.5, 1.5), (2.0, 0.5)),
    "1", "convention",
    "Speed and amplitude of proposed motions, as multiples of the first run's.")
LARGE_ERROR_Z = Limit("large error z", 3.0, "1", "convention",
    "Standard deviations of what the arm file knows of a sensor beyond which its error competes with effects, and what "
    "the square of such an error costs.")
MOST_FREED = Limit("most freed", 4, "1", "trial",
    "Errors of sensors that may win against effects at most.")
FREED_AT_A_TIME = Limit("freed at a time", 8, "1", "trial",
    "Errors of sensors that are tried at a time.")
FREED_LEAVES = Limit("freed leaves", 0.5, "1", "trial",
    "Share of what a fit leaves over and pays for errors of sensors that may be left where one of them is free.")
ERROR_STEPS = Limit("error steps", 8, "1", "convention",
    "Steps by which the size of an error of a sensor is found at most.")
ERROR_CLOSE = Limit("error close", 0.001, "1", "convention",
    "Share by which the last of those steps changes it.")
SHIFT = Limit("shift", 1e-6, "rad, rad/s, Nm", "convention",
    "Error of a sensor with which the columns of such errors are computed.")
ROWS_OF_A_WINDOW = Limit("rows of a window", 8, "1", "trial",
    "Rows of a sum in a window of the smoother: readings next to each other share nearly all their noise.")
INVERTED = Limit("inverted", 4, "1", "convention",
    "Steps by which an error of a sensor is taken off readings; each leaves so large a share of what the one before "
    "left as the error changes by where the reading changes.")
OFFSET_NM = Limit("offset nm", 1e2, "Nm", "convention",
    "Standard deviation of the constant error of a torque sensor that has noise: nobody declares it.")
MANY_SHAPES = Limit("many shapes", 6, "1", "trial",
    "Shapes of a law from which on a search begins with a part of them.")
LOOSE = Limit("loose", 0.1, "rad, rad/s", "convention",
    "Standard deviation of an error of a sensor of which nothing is known.")
GAIN = Limit("gain", 0.02, "1", "convention",
    "Standard deviation of the gain of a torque sensor against that of the first one.")
ARCS_S = Limit("arcs s", (10.0, 5.0, 3.0, 2.0), "s", "trial",
    "Lengths of arcs, the first of which is taken that covers enough: the work sums up the torques' noise, and a "
    "constant for each arc costs what the encoders' noise allows to know.")
COVERED = Limit("covered", 0.8, "1", "convention",
    "Share of the most that any length of arcs covers which the chosen one covers at least.")
SERVO_RATE = Limit("servo rate", 1.0, "rad/s", "convention",
    "Bandwidth of the servo of a twin: slow against the arm's own modes, fast against the drift of a wrong model.")
SERVO_HOLDS = Limit("servo holds", 3.0, "1", "trial",
    "Bandwidth of the servo in units of the rate at which an arm falls.")
SERVO_RIGID = Limit("servo rigid", 4.0, "1", "trial",
    "Bandwidth of the servo of an arm with a rigid joint, in units of that of another.")
SERVO_OF_SAMPLING = Limit("servo of sampling", 0.1, "1", "convention",
    "Bandwidth of the servo at most, in units of the sampling rate.")
POSTURES_EVERY = Limit("postures every", 97, "1", "convention",
    "One posture of so many instants gives the inertia that a servo moves.")
FALL_STEP = Limit("fall step", 1e-3, "rad", "convention",
    "Step of the differences that give the rate at which an arm falls.")
TWIN_SEEDS = Limit("twin seeds", 1_000_000_000, "1", "convention",
    "Seeds of twins begin here: a simulated run with a small seed would have the same noise, some cycles earlier.")
TOLD_APART = Limit("told apart", 1e-12, "1", "convention",
    "Smallest eigenvalue of sums, scaled to a unit diagonal, from which on the coefficients are told apart.")
HORIZON_S = Limit("horizon s", 0.5, "s", "convention",
    "Length of the stretches over which predictions are compared.")
FORECAST_ROUNDS = Limit("forecast rounds", 3, "1", "convention",
    "Steps of the fit of a stretch's initial state.")
DIVERGED = Limit("diverged", 1e200, "1", "convention",
    "Size of a state from which on a prediction has diverged.")
STRAY = Limit("stray", 30.0, "rad", "convention",
    "Angle by which a state may stray in the fit of a stretch.")
MOST_STRETCHES = Limit("most stretches", 60, "1", "convention",
    "Stretches that are predicted at most; fewer of arms with long states.")
LONG_STATE = Limit("long state", 16, "1", "convention",
    "Length of a state from which on it is long.")
SLOPE_WINDOW_S = Limit("slope window s", 0.1, "s", "trial",
    "Time over which the slope of a residual is taken: the torque, or the power, that is missing.")
BINS = Limit("bins", 24, "1", "convention",
    "Classes of a quantity in which what is left over is averaged.")
TELLS = Limit("tells", 0.2, "1", "trial",
    "Share of the square of what is left over that must go with a quantity for it to be mentioned.")
BIN_VALUES = Limit("bin values", 4, "1", "convention",
    "Values in a class that has a median.")
DIFFERENCES = Limit("differences", 3, "1", "trial",
    "Differences that leave nothing of a motion but what changes from cycle to cycle.")
LAGS = Limit("lags", 4, "1", "trial",
    "Readings that a servo answers to: the newest and those before.")
ROUNDING_Z = Limit("rounding z", 3.0, "1", "convention",
    "Noise below so many deviations of the rounding on the bus is none.")
FEWEST_CYCLES = Limit("fewest cycles", 200, "1", "convention",
    "Cycles from which the noise of torques is estimated at least.")
NOISE_Z = Limit("noise z", 2.0, "1", "convention",
    "Deviations beyond what a motor balance shows of the noise from which on more is ruled out.")
MEDIAN_EFFICIENCY = Limit("median efficiency", 0.37, "1", "derived",
    "Efficiency of the squared median of absolute values as an estimate of a variance.")
MEDIAN_DEVIATION = Limit("median deviation", 0.6745, "1", "derived",
    "Median of the absolute values of the standard normal distribution.")
RCOND_OF_CONTROLLER = Limit("rcond of controller", 1e-9, "1", "convention",
    "Smallest singular value, scaled, of the equations of a controller.")
COMMON = Limit("common", 0.9, "1", "convention",
    "Share of the simulated cycles that the measured run must have.")
SHOWN_Z = Limit("shown z", 3.0, "1", "convention",
    "Standard deviations from which on the run of a simulator shows an effect.")
SYSTEMATIC = Limit("systematic", 3e-4, "1", "trial",
    "Share of a parameter by which fits of single runs of 20 s were found to err beyond their twins' draws.")
BLIND = Limit("blind", 1e-9, "1", "convention",
    "Share of the largest scaled derivative below which the parameters do not show an element.")
DIFFERENCE_STEP = Limit("difference step", 1e-6, "1", "convention",
    "Step of the differences by the elements of a body, in units of their sizes.")
LEAST_REACH_M = Limit("least reach m", 1e-3, "m", "convention",
    "Distance of a body from its joint in the sizes of its elements, at least.")
ELEMENTS_TOLD_APART = Limit("elements told apart", 1e-10, "1", "convention",
    "Smallest eigenvalue of the normal equations, scaled, at which elements are told apart.")
RTOL = Limit("rtol", 1e-07, "1", "convention",
    "Relative tolerance of the integration of a proposed motion: its errors are far below the noise of the sensors.")
ATOL = Limit("atol", 1e-09, "rad, rad/s", "convention",
    "Absolute tolerance of that integration.")

# Changes during a run
CHANGE_Z = Limit("change z", 6.0, "1", "trial",
    "Standard deviations that a change must reach.")
STEP_LEAVES = Limit("step leaves", 0.5, "1", "trial",
    "Share of what an effect with a beginning takes away that the same effect without one must leave.")
REDRAWN_FAR = Limit("redrawn far", 2.0, "1", "trial",
    "Multiple of what a balance may leave over from which on more draws of its twin say nothing else.")
CHANGE_ROUNDS = Limit("change rounds", 5, "1", "convention",
    "Twins that follow one another at most.")
CHANGE_FALLS = Limit("change falls", 0.7, "1", "trial",
    "Share of what is left over that a further twin has to leave at the most to be followed by another.")
CHANGE_TAKES = Limit("change takes", 0.6, "1", "trial",
    "Share of what is left over beyond noise that a change must take away.")
TORN = Limit("torn", 0.5, "1", "trial",
    "Share of what the best change between two arcs leaves over from which on an arc is taken as torn apart by one.")
RCOND = Limit("rcond", 1e-13, "1", "convention",
    "Smallest eigenvalue, scaled, of the equations of a change in space.")
RCOND_OF_BLOCKS = Limit("rcond of blocks", 1e-7, "1", "convention",
    "Smallest eigenvalue, scaled, of the equations of a change on the ground.")
STANDS_IN = Limit("stands in", 0.9, "1", "trial",
    "Share of the best improvement with which a simpler or another candidate stands in for the best.")
CHANGE_BLOCKS = Limit("change blocks", 2, "1", "convention",
    "Blocks on either side of a change at least.")

# The search on the ground
MATERIAL = Limit("material", 0.2, "1", "trial",
    "Share of what noise does not explain that a candidate must take away: what another law leaves looks a little "
    "like every column, and is significant because it repeats.")
EXPLAINS_MOST = Limit("explains most", 0.5, "1", "trial",
    "Share of what noise does not explain from which on a candidate needs fewer standard deviations: a law that "
    "acts in a few instants differs from block to block by more than noise if its form is another one.")
SEEN_Z = Limit("seen z", 3.0, "1", "trial",
    "The standard deviations that such a candidate needs.")
FAR = Limit("far", 4.0, "1", "trial",
    "What must be left over then over all runs, in units of noise; and from which on the usual friction stays in the "
    "model, whether it is named or not.")
NOISE = Limit("noise", 1.3, "1", "trial",
    "Mean square of a residual, in units of that of noise, from which on there is something to explain.")
KEPT_Z = Limit("kept z", 3.0, "1", "trial",
    "Standard deviations with which an effect is kept beside those that were named after it.")
MOST_TERMS = Limit("most terms", 24, "1", "convention",
    "Effects that are looked for on the ground: friction at each joint is one each.")
LATE_LEAVE = Limit("late leave", 0.8, "1", "trial",
    "Share of the squared residual that entries which are searched last may leave of what the usual ones do.")
SHORTEST_S = Limit("shortest s", 2.0, "s", "convention",
    "Length of a part of a run that was cut, at least.")
WEIGHT_ROUNDS = Limit("weight rounds", 5, "1", "convention",
    "Times that the weights follow the residuals.")
RIDGE = Limit("ridge", 1e-12, "1", "convention",
    "Weight of small values, as a share of the largest column.")
UNSEEN = Limit("unseen", 1e-7, "1", "convention",
    "Share of a column's square beside the others below which the motion does not show it.")
LEAST_RESIDUAL = Limit("least residual", 1e-24, "1", "convention",
    "Square of a residual at least, as a share of that of the torques.")
BIAS = Limit("bias", 0.5, "1", "trial",
    "Share of an effect that may be an error which its twin has as well.")
TOTAL_BLOCKS = Limit("total blocks", 60, "1", "convention",
    "Blocks of all runs together, about.")
LEAST_BLOCKS = Limit("least blocks", 6, "1", "convention",
    "Blocks of a run at least.")
ASYMMETRY = Limit("asymmetry", 0.1, "1", "convention",
    "Share of the friction that a difference between the directions must have to be spoken of.")
RESTS = Limit("rests", 0.99, "1", "convention",
    "Share of an increment that a joint must rest.")
PHASES = Limit("phases", 3, "1", "convention",
    "Phases at rest that must agree.")
GRAVITY_OFF = Limit("gravity off", 0.5, "m/s^2", "convention",
    "Difference to the gravity of the arm file that is a matter of the arm file.")
GRAVITY_EXPLAINS = Limit("gravity explains", 0.9, "1", "trial",
    "Share of the squared residual of a joint, with the usual friction, that it must take away.")
GRAVITY_BLOCKS = Limit("gravity blocks", 10, "1", "convention",
    "Of each run, one of which after the other is left out.")
LATE = Limit("late", 0.4, "1", "trial",
    "Periods by which all torques must be late or early to be a matter of the arm file.")
LATE_EXPLAINS = Limit("late explains", 0.5, "1", "trial",
    "Share of what friction and noise leave that a delay must take away on every run.")
SHAPE_STEPS = Limit("shape steps", (1.0 / 4.0, 1.0 / 16.0), "1", "convention",
    "Distances of the shapes of the finer grids, in steps of the catalogue's grid.")
NEIGHBOUR = Limit("neighbour", 1.1, "1", "convention",
    "Ratio of two shapes whose columns together leave the shape open.")

# Words
FAILS = Limit("fails", 2.0, "1", "convention",
    "Residual of a joint over its floor from which on it is said to fail.")
SIZED = Limit("sized", 2, "1", "convention",
    "Findings of one kind up to which a sentence says their sizes; those of more joints are in the table.")
VISIBLE = Limit("visible", 10.0, "1", "convention",
    "Error of predictions over the floor that is plain to see.")
SAID = Limit("said", 4, "1", "convention",
    "Values that a sentence names; a table has all.")

# Estimates on the ground
ANGLE_NOISE = Limit("angle noise", 0.3, "1", "convention",
    "Share of the squared residuals that the declared noise of the angles may cause at the chosen length of "
    "increments.")
CLUSTER = Limit("cluster", 4.0, "1", "trial",
    "Largest mean square of a block's summed residuals, in units of that of independent ones, that passes as noise.")
EXCESS_OF_NOISE = Limit("excess of noise", 2.0, "1", "trial",
    "Largest residual, in units of the noise of torques and angles, that passes as noise.")
CUTOFF_MOVES = Limit("cutoff moves", 2.0, "1", "trial",
    "Half widths by which another cut-off may move a value; on simulated rigid arms the largest of all values moves "
    "by up to 1.3.")
OTHER_CUTOFFS = Limit("other cutoffs", (0.7, 1.4), "1", "convention",
    "Other spans of the smoother, as multiples of the chosen one, with which an estimate is compared.")
DOUBTFUL = Limit("doubtful", 0.5, "1", "convention",
    "Share of the held-out torque of a joint that is left, above which an estimate on the ground is doubtful.")
TORQUE_NOISE = Limit("torque noise", 0.1, "1", "convention",
    "Largest noise of the mean torques as a share of their root mean square.")
HIGHEST_CUTOFF_HZ = Limit("highest cutoff hz", 10.0, "Hz", "convention",
    "Cut-off above which torques are not compared: accelerations from encoders are noise there.")
SLOW_Z = Limit("slow z", 4.0, "1", "convention",
    "Rate, in standard deviations of its noise, below which its sign is not known.")
LINGERING = Limit("lingering", 0.3, "1", "trial",
    "Share of an increment at such rates from which on its row is left out.")
CREEP = Limit("creep", 0.02, "1", "trial",
    "Rate, as a share of the joint's root mean square, below which a joint creeps or is at rest: no law of friction "
    "is certain there.")
CREEPING_S = Limit("creeping s", 0.2, "s", "trial",
    "Time that a joint stays below that rate when it creeps: the phases before and after a stop are far longer than "
    "a reversal.")
RANK = Limit("rank", 1e-10, "1", "convention",
    "Smallest pivot, of columns scaled to unit length, with which a combination of columns counts as seen.")

GAIN_PRIOR = Limit("gain prior", 0.1, "1", "convention",
    "Standard deviation of the gain of a torque sensor against that of the first one, before any run.")
STRANGE_GAIN = Limit("strange gain", 4.0, "1", "convention",
    "Standard deviations of that prior beyond which a gain is doubted where something is left of the torques: what the "
    "model lacks, for example friction, looks like a gain.")
CURRENT_GAIN_PRIOR = Limit("current gain prior", 1.0, "1", "convention",
    "The same of a motor current, which is in proportion to the torque by an unknown torque constant.")
GAIN_ROUNDS = Limit("gain rounds", 40, "1", "convention",
    "Steps by which gains of torque sensors are found at most.")
GAIN_STEP = Limit("gain step", 2.0, "1", "convention",
    "Ratio by which the torque of a sensor may change in one of these steps.")

# Audits of logs
AUDIT_SURE = Limit("audit sure", 1.5, "1", "trial",
    "Factor by which the unexplained part of the equations must shrink before a fault is reported. In trials with "
    "the examples, wrong readings left 1.9 times as much or more, and changes to correct readings did not shrink it "
    "(tests/unit/test_audit.py).")
SURE_LAW = Limit("sure law", 1.15, "1", "trial",
    "The same for the torque law, whose effect is small: in the trials a wrong law left 1.2 times as much or more, "
    "and the best one at most 0.97 of the next.")
LIKELY_LAW = Limit("likely law", 1.03, "1", "trial",
    "If the declared law is better by less than that factor, it is not decided.")
SURE_SCALE = Limit("sure scale", 8.0, "1", "trial",
    "The same for the scale of a torque, which is fitted. In eight correct runs of a simulated arm of seven joints, "
    "another scale of one torque fitted up to 1.9 times better (tests/unit/test_rigid_audit.py), in a measured run of "
    "a double pendulum 5.6 times.")
SCALE_OFF = Limit("scale off", 1.2, "1", "trial",
    "A scale is reported if it is off by more than that factor.")
WEIGHED = Limit("weighed", 0.05, "1", "convention",
    "Largest standard deviation, as a share, of a torque's scale against the masses of a simulation.")
AUDIT_CLOSES = Limit("audit closes", 0.4, "1", "trial",
    "Largest share of each torque that the law of the whole rigid arm leaves unexplained after a reported change. A "
    "simulated arm of seven joints leaves 0.003 to 0.09, a real pendulum of two joints 0.05 to 0.31.")
SIGN_EXPLAINED = Limit("sign explained", 0.9, "1", "trial",
    "Largest unexplained share of a torque at which its sign is still decided.")
MOTOR_FITS = Limit("motor fits", 0.5, "1", "trial",
    "Share of a torque that its motor's law alone leaves unexplained above which the law does not fit, and no fault "
    "is reported from it. Simulated joints leave at most 0.04, those of a KUKA KR300 0.44, and a real pendulum of "
    "two coupled rigid joints 0.4 to 0.9.")
MOTOR_FITS_WELL = Limit("motor fits well", 0.1, "1", "trial",
    "The same share below which the law needs no confirmation by the balance.")
FLATTENED_Z = Limit("flattened z", 3.5, "1", "trial",
    "A smoother of the next order moves a value by more than so many standard deviations where the declared one "
    "takes too much off the motion. Noise reaches 2.6 in the trials of the examples, a motion that is flattened 5.3 "
    "(tests/unit/test_audit.py).")
SKEW_Z = Limit("skew z", 4.0, "1", "convention",
    "Standard errors that a skew exceeds if it is reported.")
SKEW = Limit("skew", 0.1, "1", "convention",
    "Share of the period that a skew exceeds if it is reported.")
ZERO_Z = Limit("zero z", 6.0, "1", "convention",
    "Standard errors that an offset of an encoder exceeds if it is reported.")
UNIT_NOISE = Limit("unit noise", 100.0, "1", "convention",
    "Factor of a torque's noise above the declared one from which another unit is the likelier cause.")
NOISE_OFF = Limit("noise off", 2.5, "1", "trial",
    "Noise above that multiple of the declared one is reported. In the trials a controller moves the base by its own "
    "noise, which reaches 2.2.")
AS_NOISY = Limit("as noisy", 0.5, "1", "trial",
    "Share of the declared noise from which readings whose steps are finer than declared need them: `zygos convert` "
    "adds the noise of interpolation to a quantum, and keeps the readings where the samples lie on the grid.")
TORQUE_NOISE_SEEN = Limit("torque noise seen", 1e-3, "1", "trial",
    "Noise of a torque is reported if it exceeds this share of its standard deviation; below, it is the curvature "
    "of the command. The examples' torques reach 4e-5, measured ones 6e-3 or more.")
FOLLOWS = Limit("follows", 0.3, "1", "trial",
    "Share of a torque's noise that is not correlated with other readings below which a controller makes the noise "
    "from those readings.")
ALONE = Limit("alone", 0.95, "1", "trial",
    "The same share above which the noise is independent of them; in between nothing is decided.")
FLAT_CYCLES = Limit("flat cycles", 20, "1", "convention",
    "Cycles over which the code of a reading is constant if it is stuck.")
FLAT = Limit("flat", 0.02, "1", "convention",
    "Share of its range by which the partner of a stuck reading moves meanwhile.")
FLAT_TOPS = Limit("flat tops", 3, "1", "convention",
    "Runs of equal codes at an end of the range that are saturation rather than chance.")
FLAT_TOP_CYCLES = Limit("flat top cycles", 3, "1", "convention",
    "Equal codes of such a run.")
FLAT_TOP = Limit("flat top", 0.002, "1", "convention",
    "Share of the readings that such runs must have.")
LOST = Limit("lost", 0.02, "1", "convention",
    "Share of lost cycles above which the loss is reported.")
PERIOD_OFF = Limit("period off", 0.005, "1", "convention",
    "Share by which the time between SYNC frames may differ from the declared period.")
STEP_OFF = Limit("step off", 0.02, "1", "convention",
    "Share by which the steps of a reading may differ from the declared quantum.")
ON_GRID = Limit("on grid", 0.99, "1", "convention",
    "Share of the differences of readings that are multiples of a step from which on it is their quantum.")
FLAT_QUANTA = Limit("flat quanta", 20.0, "1", "convention",
    "A joint that moves by less than that many quanta counts as not moving.")
STIFF = Limit("stiff", 0.99, "1", "convention",
    "Correlation of the two encoders' rates from which the deflection counts as a small difference.")
OUTLIER_Z = Limit("outlier z", 5.0, "1", "convention",
    "Standard deviations beyond which a reading is excluded from fits: a jump of the command is not noise.")
OUTLIER_ROUNDS = Limit("outlier rounds", 3, "1", "convention",
    "Times that such readings are excluded.")

# Refinement
RULE_Z = Limit("rule z", 3.0, "1", "convention",
    "Standard errors that a rule allows.")
RIVAL_Z = Limit("rival z", 4.0, "1", "convention",
    "Standard deviations by which the readings may favour a model with one thing more: one of many that are tried.")
ENERGY_BIAS = Limit("energy bias", 0.002, "1", "trial",
    "Share of the sizes by which the estimate from energy rows may be off beside its intervals, which do not know "
    "noise in proportion to the torques.")
INNOVATION_EXCESS = Limit("innovation excess", 0.1, "1", "trial",
    "By which the mean square of normalised innovations may exceed what chance explains: a solution is linear, and "
    "encoder steps are not normally distributed.")
SIMPLER = Limit("simpler", 9.0, "1", "convention",
    "Deviance by which noise in proportion to the torques must be better than none.")
LINEAR_ERROR = Limit("linear error", 10.0, "1", "trial",
    "Noise of the torques that passes though none in proportion is declared, as a multiple of the constant one: so "
    "much is taken for noise that is the error of the linear motion.")
START_MOST = Limit("start most", 0.01, "1", "trial",
    "Largest standard deviation of any combination of parameters before the first reading, in units of the sizes: "
    "more leads a solution out of the range in which the motion is linear. A start that is farther off takes "
    "several passes.")
# fmt: on

TABLE: tuple[Limit[object], ...] = tuple(found for found in list(globals().values()) if isinstance(found, Limit))
"""In the order of this file."""
