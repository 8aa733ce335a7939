import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emran_sumo.control.cruise import CruiseParams
from emran_sumo.control.emran import (
    DELETED,
    GROWN,
    LEARNED,
    MERGED,
    NEURONS,
    PRUNED,
    RESERVED,
    SAMPLES,
    EmranParams,
    activation,
    blank_memory,
    fade,
    gradient,
    initial_variance,
    learn,
    learn_bias,
    predict,
    prune,
    variance_drift,
)
from emran_sumo.kernels import njit

T = 0.01
# every sample teaches, nothing limits: the bare algorithm of Eq. 11-17
BARE = EmranParams(
    eps_max=1.0, eps_min=1.0, gamma=1.0, error_delete=0.0, error_learn=0.0, error_grow=0.0, rms_grow=0.0, window=4,
    overlap=0.8, growth_gain=0.5, rate_initial=20.0, rate_steady=5.0, width_min=1e-6, width_max=100.0,
    center_step=10.0, output_max=100.0, prune_share=0.0, merge_distance=0.0, neurons_max=40,
)  # fmt: skip


def network(neurons, params=BARE, variance=0.1):
    """A network that holds given neurons: (center, width, weight) each."""
    inputs = len(neurons[0][0])
    memory = blank_memory(params, inputs)
    for k, (center, width, weight) in enumerate(neurons):
        memory.centers[k] = center
        memory.widths[k] = width
        memory.weights[k] = weight
        memory.covariance[k] = variance * np.eye(inputs + 2)
    memory.counts[NEURONS] = len(neurons)
    return memory


def at(*values):
    return np.array(values, dtype=float)


# ---------------------------------------------------------------- output and gradient


def test_empty_network_says_nothing():
    assert predict(BARE, blank_memory(BARE, 3), at(1, 2, 3)) == 0.0


def test_output_is_the_sum_of_gaussians_and_bias():
    memory = network([((0, 0), 1.0, 2.0), ((3, 4), 2.0, -1.0)])
    memory.bias[0] = 0.25
    expected = 0.25 + 2.0 * math.exp(-25 / 2) - 1.0
    assert predict(BARE, memory, at(3, 4)) == pytest.approx(expected, rel=1e-12)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
@settings(deadline=None)
def test_output_is_bounded(weight, bias, place):
    params = BARE._replace(output_max=0.15)
    memory = network([((0.0,), 1.0, weight)])
    memory.bias[0] = bias
    assert abs(predict(params, memory, at(place))) <= 0.15


unit = st.floats(-2, 2)


@given(st.tuples(unit, unit, unit), st.tuples(unit, unit, unit), st.floats(0.3, 3), unit)
@settings(deadline=None)
def test_gradient_is_that_of_finite_differences(inputs, center, width, weight):
    h = 1e-6
    found, v = np.empty(5), np.array(inputs)
    gradient(network([(center, width, weight)]), 0, v, found)

    def output(theta):
        memory = network([(theta[1:4], theta[4], theta[0])])
        return memory.weights[0] * activation(memory, 0, v)

    theta = np.array([weight, *center, width])
    step = h * np.eye(5)
    expected = [(output(theta + s) - output(theta - s)) / (2 * h) for s in step]
    np.testing.assert_allclose(found, expected, atol=2e-7 * (1 + abs(weight) / width**3))


# ---------------------------------------------------------------- Kalman filter


def joseph(theta, p, v, error, q):
    """One update of an extended Kalman filter for one Gaussian neuron, dense and in Joseph form, R = 1."""
    weight, center, width = theta[0], theta[1:-1], theta[-1]
    away = v - center
    z = np.exp(-(away @ away) / (2 * width**2))
    b = np.concatenate(([z], weight * z * away / width**2, [weight * z * (away @ away) / width**3]))
    gain = p @ b / (1.0 + b @ p @ b)
    keep = np.eye(b.size) - np.outer(gain, b)
    return theta + gain * error, keep @ p @ keep.T + np.outer(gain, gain) + np.diag(q)


def theta_of(memory):
    return np.array([memory.weights[0], *memory.centers[0], memory.widths[0]])


@pytest.mark.parametrize("seed", range(20))
def test_one_neuron_learns_like_a_dense_extended_kalman_filter(seed):
    rng = np.random.default_rng(seed)
    params = BARE._replace(neurons_max=1, shape_gain=rng.uniform(0.1, 1), rate_steady=rng.uniform(0, 20))
    q = variance_drift(params, 1.0, T) * np.array([1.0, *[params.shape_gain] * 5])
    memory = network([(rng.normal(size=4), rng.uniform(0.5, 2), rng.normal())], params)
    root = rng.normal(size=(6, 6))
    memory.covariance[0] = 0.05 * root @ root.T
    theta, p = theta_of(memory), memory.covariance[0].copy()
    for _ in range(300):
        v, error = rng.normal(size=4), 0.3 * rng.normal()
        theta, p = joseph(theta, p, v, error, q)
        theta[0] = np.clip(theta[0], -100, 100)
        assert learn(params, memory, v, error, 1.0, T)
        np.testing.assert_allclose(theta_of(memory), theta, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(memory.covariance[0], p, rtol=1e-8, atol=1e-9)
        theta, p = theta_of(memory), memory.covariance[0].copy()  # rounding must not add up over the run
        if theta[-1] < 0.3:
            theta[-1] = memory.widths[0] = 0.3


def test_only_the_nearest_neuron_is_corrected():
    memory = network([((0.0,), 1.0, 1.0), ((1.0,), 1.0, 1.0)])
    learn(BARE, memory, at(0.9), 0.1, 1.0, T)
    assert memory.weights[0] == 1.0
    assert memory.weights[1] > 1.0


@njit
def learn_many(params, memory, inputs, errors, snapshots, every):
    for i in range(errors.size):
        learn(params, memory, inputs[i], errors[i] - predict(params, memory, inputs[i]), 1.0, 0.01)
        if i % every == 0:
            snapshots[i // every] = memory.covariance[: snapshots.shape[1]]


@pytest.mark.parametrize(
    "params",
    [EmranParams(), CruiseParams().emran, BARE, BARE._replace(rate_initial=90.0, rate_steady=90.0, center_step=0.5)],
    ids=["steering", "cruise", "bare", "fastest"],
)
def test_covariance_stays_symmetric_and_positive_definite(params):
    rng = np.random.default_rng(3)
    count, every, inputs = 100_000, 200, 4
    memory = blank_memory(params, inputs)
    snapshots = np.zeros((count // every, params.neurons_max, inputs + 2, inputs + 2))
    signals = params.output_max * rng.uniform(-1, 1, count)
    learn_many(params, memory, rng.normal(scale=2, size=(count, inputs)), signals, snapshots, every)
    used = snapshots[np.abs(snapshots).max(axis=(2, 3)) > 0]
    assert len(used) > 400
    assert np.isfinite(used).all()
    np.testing.assert_array_equal(used, np.swapaxes(used, 1, 2))
    assert np.linalg.eigvalsh(used).min() > 0.0
    assert (memory.widths >= params.width_min).all()
    assert (memory.widths <= params.width_max).all()
    assert (np.abs(memory.weights) <= params.output_max).all()


# ---------------------------------------------------------------- learning


@pytest.mark.parametrize("needed", [0.05, -0.05])
def test_constant_output_is_learned_with_its_sign(needed):
    params = EmranParams()
    memory, v = blank_memory(params, 4), at(0.1, 0.2, 0.3, 0.4)
    for _ in range(1000):
        learn(params, memory, v, needed - predict(params, memory, v), 1.0, T)
    assert predict(params, memory, v) == pytest.approx(needed, abs=1.001 * params.error_learn)


def test_norm_of_the_error_as_printed_would_learn_the_wrong_sign():
    params = EmranParams()
    memory, v = blank_memory(params, 4), at(0.1, 0.2, 0.3, 0.4)
    for _ in range(1000):
        learn(params, memory, v, abs(-0.05 - predict(params, memory, v)), 1.0, T)
    assert predict(params, memory, v) > 0.1


@pytest.mark.parametrize("rate", [0.5, 2.947, 18.27, 60.0])
@pytest.mark.parametrize("scale", [1.0, 0.4])
@pytest.mark.parametrize("period", [0.005, 0.01])
def test_first_correction_follows_the_signal_at_the_initial_rate(rate, scale, period):
    params = BARE._replace(rate_initial=rate, growth_gain=0.0)
    memory, v = blank_memory(params, 3), at(1, 2, 3)
    learn(params, memory, v, 1.0, scale, period)
    assert memory.counts[GROWN] == 1
    assert predict(params, memory, v) == 0.0
    learn(params, memory, v, 0.7, scale, period)
    assert predict(params, memory, v) == pytest.approx(0.7 * rate * scale * period, rel=1e-12)
    assert initial_variance(params, scale, period) > 0.0


@pytest.mark.parametrize("rate", [0.5, 2.673, 30.0])
def test_later_corrections_follow_the_signal_at_the_steady_rate(rate):
    params = BARE._replace(rate_steady=rate, growth_gain=0.0, output_max=1e6)
    memory, v = blank_memory(params, 3), at(1, 2, 3)
    step = 0.0
    for k in range(8000):
        before = predict(params, memory, v)
        # signals of both signs keep the output, and with it the gradient to center and width, small
        learn(params, memory, v, 1e-6 * (-1) ** k, 1.0, T)
        step = abs(predict(params, memory, v) - before) / 1e-6
    assert step == pytest.approx(rate * T, rel=1e-6)


def test_learning_a_sine_leaves_a_twentieth_of_it():
    rng = np.random.default_rng(1)
    params = BARE._replace(eps_max=1.0, eps_min=0.7, gamma=0.99, error_grow=0.02, rms_grow=0.01, rate_initial=30.0)
    memory = blank_memory(params, 1)
    for x in rng.uniform(-math.pi, math.pi, 6000):
        learn(params, memory, at(x), math.sin(x) - predict(params, memory, at(x)), 1.0, T)
    grid = np.linspace(-math.pi, math.pi, 201)
    left = [math.sin(x) - predict(params, memory, at(x)) for x in grid]
    assert np.sqrt(np.mean(np.square(left))) < np.sqrt(0.5) / 20
    assert memory.counts[NEURONS] <= 12  # centers stand at least eps_min apart when they are born


def test_bias_follows_a_signal_exponentially_and_stays_bounded():
    params = BARE._replace(bias_rate=5.0, output_max=0.5)
    memory = blank_memory(params, 2)
    for _ in range(100):
        learn_bias(params, memory, 0.3 - memory.bias[0], 1.0, T)
    assert memory.bias[0] == pytest.approx(0.3 * (1 - math.exp(-5.0)), rel=1e-9)
    for _ in range(1000):
        learn_bias(params, memory, 10.0, 1.0, T)
    assert memory.bias[0] == 0.5


def test_fading_scales_the_weights_and_only_on_request_the_bias():
    memory = network([((0.0,), 1.0, 2.0), ((5.0,), 1.0, -4.0)])
    memory.bias[0] = 1.0
    fade(memory, 0.5, False)
    assert (*memory.weights[:2], memory.bias[0]) == (1.0, -2.0, 1.0)
    fade(memory, 0.5, True)
    assert (*memory.weights[:2], memory.bias[0]) == (0.5, -1.0, 0.5)


# ---------------------------------------------------------------- growth


GROWING = BARE._replace(error_grow=0.5, rms_grow=0.3)


@pytest.mark.parametrize(
    ("place", "error", "earlier", "grows"),
    [
        (2.0, 1.0, 1.0, True),
        (0.9, 1.0, 1.0, False),  # not new
        (2.0, 0.49, 1.0, False),  # too small an error
        (2.0, -0.51, 1.0, True),  # its sign does not matter
        (2.0, 0.58, 0.0, False),  # rms over four samples 0.29
        (2.0, 0.62, 0.0, True),  # rms 0.31
        (0.9, 0.49, 0.0, False),
    ],
)
def test_neuron_is_added_only_when_all_three_tests_of_eq_13_pass(place, error, earlier, grows):
    memory = network([((0.0,), 1.0, 0.1)], GROWING)
    memory.errors[:] = earlier
    memory.counts[SAMPLES] = 4
    assert learn(GROWING, memory, at(place), error, 1.0, T)
    assert memory.counts[NEURONS] == (2 if grows else 1)
    assert memory.counts[GROWN] == grows


def test_window_of_errors_counts_only_samples_seen():
    memory = blank_memory(GROWING, 1)
    learn(GROWING, memory, at(0), 0.5, 1.0, T)  # rms of this one sample is 0.5, over four places it would be 0.25
    assert memory.counts[NEURONS] == 1


def test_novelty_distance_shrinks_to_its_floor():
    params = BARE._replace(eps_max=2.0, eps_min=0.5, gamma=0.9)
    memory = blank_memory(params, 1)
    for k in range(40):
        assert memory.scale[0] == pytest.approx(max(2.0 * 0.9**k, 0.5))
        learn(params, memory, at(0), 0.1, 1.0, T)


@pytest.mark.parametrize(("distance", "expected"), [(1.5, 0.8 * 1.5), (2.9, 0.8 * 2.9), (50.0, 0.8 * 3.0)])
def test_new_neuron_has_the_center_width_and_weight_of_eq_14(distance, expected):
    memory = blank_memory(BARE, 2)
    learn(BARE, memory, at(1, 1), 0.6, 1.0, T)
    assert memory.widths[0] == pytest.approx(0.8 * 1.0)  # no neighbor: eps_1
    assert memory.weights[0] == pytest.approx(0.5 * 0.6)
    v = at(1 + 0.6 * distance, 1 - 0.8 * distance)
    learn(BARE, memory, v, -0.4, 1.0, T)
    assert memory.counts[NEURONS] == 2
    np.testing.assert_array_equal(memory.centers[1], v)
    assert memory.widths[1] == pytest.approx(expected)  # a far neuron is no wider than three times eps_1
    assert memory.weights[1] == pytest.approx(0.5 * -0.4)
    p0 = initial_variance(BARE, 1.0, T)
    np.testing.assert_allclose(memory.covariance[1], p0 * np.eye(4), rtol=1e-12)
    assert (memory.idle[1], memory.age[1]) == (0, 0)


def test_number_of_neurons_never_exceeds_the_cap():
    rng = np.random.default_rng(2)
    params = BARE._replace(neurons_max=7, eps_max=0.1, eps_min=0.1)
    memory = blank_memory(params, 3)
    for _ in range(500):
        learn(params, memory, rng.normal(scale=5, size=3), rng.normal(), 1.0, T)
        assert memory.counts[NEURONS] <= 7
    assert memory.counts[NEURONS] == memory.counts[GROWN] == 7


@given(st.lists(st.floats(-1, 1), max_size=60))
@settings(deadline=None)
def test_every_sample_is_deleted_reserved_or_learned(errors):
    params = BARE._replace(error_delete=0.2, error_learn=0.5)
    memory = blank_memory(params, 1)
    for k, error in enumerate(errors):
        before = memory.weights.copy()
        learned = learn(params, memory, at(k % 5), error, 1.0, T)
        assert learned == (abs(error) >= 0.5)
        if not learned:
            np.testing.assert_array_equal(memory.weights, before)
    sizes = np.abs(errors)
    counts = memory.counts
    assert counts[SAMPLES] == len(errors) == counts[DELETED] + counts[RESERVED] + counts[LEARNED]
    assert counts[DELETED] == (sizes < 0.2).sum()
    assert counts[LEARNED] == (sizes >= 0.5).sum()
    assert counts[NEURONS] == counts[GROWN] - counts[PRUNED] - counts[MERGED]


# ---------------------------------------------------------------- pruning and merging


PRUNING = BARE._replace(prune_share=0.05, prune_samples=20)


def pruned_after(memory, v, calls, params=PRUNING):
    for k in range(calls):
        prune(params, memory, v)
        if memory.counts[PRUNED]:
            return k + 1
    return None


def test_old_idle_neuron_is_removed_after_the_window_and_the_active_one_stays():
    memory = network([((9.0,), 1.0, 1.0), ((0.0,), 1.0, 1.0)])
    memory.age[:2] = 1000
    assert pruned_after(memory, at(0), 100) == 20
    assert memory.counts[NEURONS] == 1
    assert memory.centers[0, 0] == 0.0
    assert predict(PRUNING, memory, at(0)) == 1.0


def test_young_neuron_is_not_pruned_although_idle():
    memory = network([((0.0,), 1.0, 1.0), ((9.0,), 1.0, 1.0)])
    memory.idle[1] = 1000
    assert pruned_after(memory, at(0), 100) in (20, 21)


def test_contribution_now_and_then_keeps_a_neuron():
    memory = network([((0.0,), 1.0, 1.0), ((9.0,), 1.0, 1.0)])
    for k in range(200):
        prune(PRUNING, memory, at(9.0 if k % 19 == 18 else 0.0))
    assert memory.counts[NEURONS] == 2


@pytest.mark.parametrize(("share", "stays"), [(0.06, True), (0.04, False)])
def test_contribution_is_judged_relative_to_the_largest(share, stays):
    memory = network([((0.0,), 1.0, 0.01), ((0.5,), 1.0, 0.01 * share * math.exp(0.125))])
    assert (pruned_after(memory, at(0), 100) is None) == stays


def test_last_neuron_is_never_pruned():
    memory = network([((9.0,), 1.0, 1.0)])
    assert pruned_after(memory, at(0), 300) is None


def test_silent_network_is_not_pruned():
    memory = network([((9.0,), 1.0, 1.0), ((-12.0,), 1.0, 1.0)])
    assert pruned_after(memory, at(0), 300) is None


MERGING = BARE._replace(merge_distance=0.5, rate_steady=0.0)


def test_merged_neuron_gives_the_output_of_both_at_its_center():
    memory = network([((0.0, 0.0), 1.0, 3.0), ((0.4, 0.0), 1.2, 1.0), ((8.0, 0.0), 1.0, 1.0)], MERGING)
    center = at(0.75 * 0.0 + 0.25 * 0.4, 0.0)  # weighted by the magnitude of the weights
    before = 3.0 * math.exp(-0.005) + 1.0 * math.exp(-0.045 / 1.44)
    learn(MERGING, memory, at(0.05, 0.0), 0.0, 1.0, T)
    assert (memory.counts[MERGED], memory.counts[NEURONS]) == (1, 2)
    merged = int(np.argmin(np.abs(memory.centers[:2, 0])))
    np.testing.assert_allclose(memory.centers[merged], center, atol=1e-12)
    assert memory.widths[merged] == pytest.approx(0.75 * 1.0 + 0.25 * 1.2)
    assert memory.weights[merged] == pytest.approx(before, rel=1e-12)
    assert memory.centers[1 - merged, 0] == 8.0


@pytest.mark.parametrize(
    ("other", "width", "merges"), [(0.45, 1.0, True), (0.55, 1.0, False), (0.45, 1.6, False), (0.45, 1.4, True)]
)
def test_only_near_neurons_of_like_width_are_merged(other, width, merges):
    memory = network([((0.0,), 1.0, 1.0), ((other,), width, 1.0)], MERGING)
    learn(MERGING, memory, at(0), 0.0, 1.0, T)
    assert memory.counts[MERGED] == merges


def test_neurons_of_opposite_weight_cancel_where_they_merge():
    memory = network([((0.0,), 1.0, 1.0), ((0.2,), 1.0, -1.0)], MERGING)
    learn(MERGING, memory, at(0), 0.0, 1.0, T)
    assert memory.counts[NEURONS] == 1
    assert memory.weights[0] == pytest.approx(0.0, abs=1e-12)


def test_unsigned_network_pushes_one_way_whatever_is_needed():
    params = BARE._replace(unsigned=True)
    for needed in (0.5, -0.5):
        memory = network([((0.0,), 1.0, 0.0)], params)
        for _ in range(50):
            learn(params, memory, at(0), needed, 1.0, T)
        assert memory.weights[0] > 0.5
