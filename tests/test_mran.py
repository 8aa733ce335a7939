import numpy as np
import pytest

from emran_sumo.control.emran import EmranParams, blank_memory, learn, predict, prune, variance_drift
from emran_sumo.control.neurons import MERGED, NEURONS, PRUNED

T, S = 0.01, 3
L = S + 2
BARE = EmranParams(
    eps_max=1.5, eps_min=1.5, gamma=1.0, error_delete=0.0, error_learn=0.0, error_grow=0.0, rms_grow=0.0, window=4,
    overlap=0.8, growth_gain=0.5, rate_initial=20.0, rate_steady=5.0, width_min=1e-6, width_max=100.0,
    center_step=10.0, output_max=100.0, prune_share=0.0, merge_distance=0.0, neurons_max=12, shape_gain=0.3,
    all_neurons=True,
)  # fmt: skip


def parameters(memory):
    n = int(memory.counts[NEURONS])
    return np.column_stack((memory.weights[:n], memory.centers[:n], memory.widths[:n])).ravel()


def covariance(memory):
    m = int(memory.counts[NEURONS]) * L
    return memory.joint[:m, :m]


def output(theta, v):
    """Of the network, from its parameters in one row."""
    rows = theta.reshape(-1, L)
    d2 = ((v - rows[:, 1:-1]) ** 2).sum(axis=1)
    return float(rows[:, 0] @ np.exp(-0.5 * d2 / rows[:, -1] ** 2))


def gradient(theta, v):
    h = 1e-6 * np.eye(theta.size)
    return np.array([(output(theta + one, v) - output(theta - one, v)) / 2e-6 for one in h])


def dense_filter(theta, p, v, error, q):
    """Extended Kalman filter over all parameters in Joseph form, R = 1, gradient by differences."""
    b = gradient(theta, v)
    gain = p @ b / (1.0 + b @ p @ b)
    keep = np.eye(b.size) - np.outer(gain, b)
    return theta + gain * error, keep @ p @ keep.T + np.outer(gain, gain) + np.diag(q)


@pytest.mark.parametrize("seed", range(5))
def test_all_neurons_learn_like_one_dense_extended_kalman_filter(seed):
    rng = np.random.default_rng(seed)
    memory = blank_memory(BARE, S)
    p0 = 0.2 / (1 - 0.2)  # rate_initial T = 0.2
    birth = p0 * np.array([1.0, *[BARE.shape_gain] * (L - 1)])
    q = variance_drift(BARE, 1.0, T) * np.array([1.0, *[BARE.shape_gain] * (L - 1)])
    theta, p, sizes = np.zeros(0), np.zeros((0, 0)), []
    for _ in range(150):
        v, error = rng.normal(size=S), 0.1 * rng.normal()
        before = int(memory.counts[NEURONS])
        assert learn(BARE, memory, v, error, 1.0, T)
        n = int(memory.counts[NEURONS])
        if n > before:  # Eq. 18: the new block beside the old one
            grown = np.zeros((n * L, n * L))
            grown[: before * L, : before * L] = p
            grown[before * L :, before * L :] = np.diag(birth)
            p, theta = grown, np.concatenate((theta, parameters(memory)[-L:]))
        else:
            theta, p = dense_filter(theta, p, v, error, np.tile(q, n))
        np.testing.assert_allclose(parameters(memory), theta, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(covariance(memory), p, rtol=1e-6, atol=1e-7)
        theta, p = parameters(memory), covariance(memory).copy()
        sizes.append(n)
    assert 3 <= max(sizes) <= BARE.neurons_max
    assert np.abs(p - np.kron(np.eye(n), np.ones((L, L))) * p).max() > 1e-3  # neurons are correlated


def test_one_neuron_is_corrected_as_the_winner_alone_is():
    winner = BARE._replace(all_neurons=False, neurons_max=1)
    alone, joint = blank_memory(winner, S), blank_memory(BARE._replace(neurons_max=1), S)
    rng = np.random.default_rng(1)
    for _ in range(200):
        v, error = rng.normal(size=S), 0.1 * rng.normal()
        learn(winner, alone, v, error, 1.0, T)
        learn(BARE._replace(neurons_max=1), joint, v, error, 1.0, T)
    np.testing.assert_allclose(parameters(joint), parameters(alone), rtol=1e-9)
    np.testing.assert_allclose(joint.covariance[0], alone.covariance[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(joint.covariance[0], covariance(joint))
    assert alone.joint is None


def grown(params, count, seed=0):
    """A network of `count` correlated neurons."""
    memory, rng = blank_memory(params, S), np.random.default_rng(seed)
    while memory.counts[NEURONS] < count:
        learn(params, memory, 2.0 * rng.normal(size=S), 0.3, 1.0, T)
    cut = params._replace(neurons_max=count)
    for _ in range(30):
        learn(cut, memory, rng.normal(size=S), 0.1 * rng.normal(), 1.0, T)
    return memory


@pytest.mark.parametrize("idle", [0, 1, 3])
def test_a_pruned_neuron_takes_its_rows_and_columns_with_it(idle):
    memory = grown(BARE, 4)
    p = covariance(memory).copy()
    memory.weights[:4] = 1.0
    memory.weights[idle] = 0.0
    memory.age[:4], memory.idle[idle] = 100, 100
    prune(BARE._replace(prune_share=1e-9, prune_samples=10), memory, memory.centers[(idle + 1) % 4].copy())
    assert (memory.counts[NEURONS], memory.counts[PRUNED]) == (3, 1)
    order = [k for k in range(4) if k != idle]
    if idle < 3:
        order = [3 if k == idle else k for k in range(3)]  # the last one takes its place
    rows = np.concatenate([np.arange(k * L, (k + 1) * L) for k in order])
    np.testing.assert_array_equal(covariance(memory), p[np.ix_(rows, rows)])


def test_merged_neurons_have_the_covariance_of_their_mean():
    memory = grown(BARE, 3)
    memory.widths[:3] = 1.0
    memory.centers[:3] = [[0, 0, 0], [5, 5, 5], [0.1, 0, 0]]
    params = BARE._replace(merge_distance=0.2, rate_steady=0.0, neurons_max=3)
    p = covariance(memory).copy()
    learn(params, memory, np.array([0.0, 0.0, 0.0]), 0.0, 1.0, T)  # no error: corrects the covariance alone
    assert (memory.counts[NEURONS], memory.counts[MERGED]) == (2, 1)
    b = np.zeros(3 * L)
    theta = np.zeros(3 * L)
    theta[0::L], theta[4::L] = grown(BARE, 3).weights[:3], 1.0
    theta[L + 1 : L + 4], theta[2 * L + 1] = 5.0, 0.1
    b = gradient(theta, np.zeros(3))
    p -= np.outer(p @ b, p @ b) / (1.0 + b @ p @ b)
    mean = np.zeros((2 * L, 3 * L))
    mean[:L, :L] = mean[:L, 2 * L :] = 0.5 * np.eye(L)
    mean[L:, L : 2 * L] = np.eye(L)
    np.testing.assert_allclose(covariance(memory), mean @ p @ mean.T, rtol=1e-6, atol=1e-8)


def test_covariance_stays_symmetric_and_positive_definite_while_neurons_come_and_go():
    params = EmranParams(all_neurons=True, eps_max=1.0, eps_min=0.8, neurons_max=15, prune_samples=20)
    memory, rng, most = blank_memory(params, 4), np.random.default_rng(3), 0
    for _ in range(4000):
        v = rng.normal(size=4)
        learn(params, memory, v, 0.1 * np.sin(v[0]) - predict(params, memory, v), 1.0, T)
        prune(params, memory, v)
        m = int(memory.counts[NEURONS]) * 6
        most = max(most, m)
        p = memory.joint[:m, :m]
        np.testing.assert_array_equal(p, p.T)
    assert np.linalg.eigvalsh(p).min() > 0.0
    assert most > 24
    assert memory.counts[PRUNED] > 0
    assert memory.joint.shape == (90, 90)  # what it may ever need


def test_mran_drives_the_lane_change_about_as_emran_does(bench, double_lane_change):
    from emran_sumo.plant.disturbance import DisturbanceParams

    push, late = DisturbanceParams(lateral_force=1500.0), slice(300, None)
    found = {
        name: np.sqrt(np.mean(
            bench.drive(double_lane_change, 10.0, 12.0, name, position=20.0, disturbance=push)
            .column("cross_track_error")[late] ** 2
        ))
        for name in ("coupled-base", "coupled-emran", "coupled-mran")
    }  # fmt: skip
    assert found["coupled-mran"] < 0.3 * found["coupled-base"]
    assert found["coupled-mran"] < 1.5 * found["coupled-emran"]
