"""The rivals of the filter, each against something independent, and their names."""

import sys

import numpy as np
import pytest

from jaxreplay import Params, Records
from jaxreplay.errors import ConfigError
from jaxreplay.filter.options import Options
from jaxreplay.loop.rivals import CONTROLLERS, controller_named, regression

RIVALS = [name for name in CONTROLLERS if name != "filter"]
ALL = np.ones(1, bool)


def params(n):
    return Params(np.full(n, 0.1), np.full(n, 0.05), np.full((n, 2), 0.1))


def drives(standing):
    """Eight drives along a line: standing for some rows, to 1 at some speed, creeping for 15 rows.

    The second sensor tells the direction of each, 1 or −1.
    """
    sensors, commands = [], []
    for speed, side in zip(np.tile([0.045, 0.05], 4), [1, 1, -1, -1, -1, -1, 1, 1], strict=True):
        drive = np.full(round(1 / speed), speed)
        u = side * np.concatenate([np.zeros(standing), drive, np.full(15, 0.004)])
        commands.append(u[:, None])
        sensors.append(np.column_stack([np.cumsum(u), np.full(len(u), side)]))
    return Records.from_sequences(sensors, commands, period=0.1)


@pytest.fixture(scope="module")
def paths():
    return drives(8)


@pytest.fixture(scope="module")
def made(paths):
    """Each rival in three slots, made once; fewer settings of the mixture are tried."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(regression, "_COMPONENTS", (40,))
        patch.setattr(regression, "_WINDOWS", (1.0,))
        return {
            name: controller_named(name)(paths, params(3), Options("same_tau")) for name in RIVALS
        }


def begun(controller):
    controller.begin(np.ones(3, bool), params(3))
    return controller


def sent(controller, observations, which):
    """The commands sent in the slots `which` while all see `[T, n_s]`, and whether each ended."""
    commands, ended = [], []
    for z in observations:
        commands.append(controller.command[which].copy())
        observed = controller.observe(np.tile(z, (3, 1)), which)
        ended.append(np.broadcast_to(observed.end_probability, 3)[which] > 0.9)
    return np.array(commands), np.array(ended)


@pytest.mark.parametrize("chosen", range(4))
def test_tape_sends_the_nearest_record(made, chosen):
    rng = np.random.default_rng(0)
    sensors = [rng.normal(size=(9 + i, 2)) for i in range(4)]
    commands = [rng.normal(size=(9 + i, 3)) for i in range(4)]
    records = Records.from_sequences(sensors, commands)
    tape = controller_named("tape")(records, params(3), Options("same_tau"))
    tape.begin(np.ones(3, bool), params(3))
    z = np.tile(sensors[chosen][4] + 1e-3, (9 + chosen, 1))
    u, ended = sent(tape, z, np.array([False, True, True]))
    np.testing.assert_allclose(u[:5, 0], commands[0][:5], rtol=1e-6)
    np.testing.assert_allclose(u[5:, 1], commands[chosen][5:], rtol=1e-6)
    assert not ended[:-1].any()
    assert ended[-1].all()


def test_nearest_is_a_search_through_all_rows():
    rng = np.random.default_rng(1)
    sensors = [rng.normal(size=(30, 2)) * [1, 100] for _ in range(3)]
    commands = [np.tanh(s[:, :1]) + rng.normal(size=(30, 1)) for s in sensors]
    records = Records.from_sequences(sensors, commands, period=0.5)
    nearest = controller_named("nearest")(records, params(3), Options("same_tau"))
    k = nearest.settings.neighbours
    scale = np.ptp(np.concatenate(sensors), axis=0)
    z = rng.normal(size=(3, 2)) * [1, 100]
    nearest.observe(z, np.ones(3, bool))
    for b in range(3):
        rows = []
        for s, u in zip(sensors, commands, strict=True):
            for t in range(30):
                away = np.sqrt((((s[t] - z[b]) / scale) ** 2).sum())
                rows.append((away, u[min(t + 1, 29), 0]))
        rows = sorted(rows)[:k]
        mean = np.average([u for _, u in rows], weights=[1 / (away + 1e-6) for away, _ in rows])
        np.testing.assert_allclose(nearest.command[b, 0], mean, rtol=1e-4)


@pytest.mark.parametrize("name", RIVALS)
def test_slots_do_not_matter_to_each_other(made, paths, name, monkeypatch):
    controller = begun(made[name])
    z = paths.sequences()[0][0]
    alone, ended = sent(controller, z, np.array([False, True, False]))
    begun(controller)
    late = np.array([True, False, False])
    together = []
    for t, row in enumerate(z):
        if t == 7:
            controller.begin(late, params(3))
        together.append(controller.command[1].copy())
        observed = controller.observe(np.stack([row[::-1], row, row * 3]), np.ones(3, bool))
        assert (np.broadcast_to(observed.end_probability, 3)[1] > 0.9) == ended[t, 0]
    np.testing.assert_array_equal(np.array(together), alone[:, 0])
    monkeypatch.setattr(regression, "_COMPONENTS", (40,))
    monkeypatch.setattr(regression, "_WINDOWS", (1.0,))
    fewer = controller_named(name)(paths, params(1), Options("same_tau"))
    for t, row in enumerate(z):
        np.testing.assert_array_equal(fewer.command[0], alone[t, 0])
        fewer.observe(row[None], ALL)


@pytest.mark.parametrize("name", RIVALS)
def test_a_demonstrated_path_is_followed_to_its_end(made, name):
    controller = begun(made[name])
    if name == "nearest":  # without memory it would stand for ever
        controller = controller_named(name)(drives(0), params(3), Options("same_tau"))
        controller.command[:, 0] = [0.05, -0.05, 0.05]
    position, side = np.zeros(3), np.array([1, -1, 1])
    ended = np.zeros(3, bool)
    for _ in range(150):
        position = np.where(ended, position, position + controller.command[:, 0])
        observed = controller.observe(np.column_stack([position, side]), ~ended)
        ended |= np.broadcast_to(observed.end_probability, 3) > 0.9
    assert ended.all()
    np.testing.assert_allclose(position, 1.05 * side, atol=0.15)


@pytest.mark.parametrize("name", RIVALS)
def test_a_missing_sensor_keeps_its_value(made, paths, name):
    z = paths.sequences()[0][0][:12]
    gaps = z.copy()
    gaps[3:, 1] = np.nan  # it is constant, so nothing is lost
    which = np.array([False, False, True])
    whole, _ = sent(begun(made[name]), z, which)
    filled, _ = sent(begun(made[name]), gaps, which)
    np.testing.assert_array_equal(whole, filled)
    mean = np.concatenate(paths.sequences()[0]).mean(axis=0)
    nothing, _ = sent(begun(made[name]), np.full((3, 2), np.nan), which)
    average, _ = sent(begun(made[name]), np.tile(mean, (3, 1)), which)
    np.testing.assert_allclose(nothing, average, atol=1e-6)


@pytest.mark.parametrize("name", RIVALS)
def test_one_record_of_a_few_rows_is_enough(name):
    records = Records.from_sequences([[[0.0, 1.0], [1.0, 1.0], [2.0, 1.0]]], [np.ones((3, 1))])
    controller = controller_named(name)(records, params(2), Options("own_tau"))
    for _ in range(5):
        controller.observe(np.zeros((2, 2)), np.ones(2, bool))
        assert np.isfinite(controller.command).all()


def test_names_are_imported_on_demand(tmp_path, monkeypatch):
    for name, place in CONTROLLERS.items():
        module, _, attribute = place.partition(":")
        assert controller_named(name) is getattr(sys.modules[module], attribute)
    (tmp_path / "my_own.py").write_text("def controller(records, params, options): ...\nvalue = 3")
    (tmp_path / "my_broken.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)
    assert controller_named("my_own:controller").__module__ == "my_own"
    for name, message in (
        ("nearst", "nearst; did you mean nearest"),
        ("a:", "no controller a:"),
        ("my_own:nothing", "my_own does not contain nothing"),
        ("my_own:value", "cannot be called"),
        ("my_broken:x", "cannot be imported: ZeroDivisionError"),
        ("no_such_module:x", "No module named 'no_such_module'"),
    ):
        with pytest.raises(ConfigError, match=message) as error:
            controller_named(name)
        assert "\n" not in str(error.value)


def test_a_missing_extra_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "jaxreplay.loop.rivals.regression", raising=False)
    for module in [m for m in sys.modules if m.partition(".")[0] == "gmr"]:
        monkeypatch.delitem(sys.modules, module)

    class Missing:
        def find_spec(self, name, path=None, target=None):
            if name == "gmr":
                raise ModuleNotFoundError("No module named 'gmr'", name="gmr")

    monkeypatch.setattr(sys, "meta_path", [Missing(), *sys.meta_path])
    with pytest.raises(ConfigError, match=r"needs gmr: pip install 'jaxreplay\[rivals\]'"):
        controller_named("regression")


@pytest.mark.parametrize("name", RIVALS)
def test_commands_stay_within_what_was_recorded(made, paths, name):
    recorded = np.concatenate(paths.sequences()[1]).astype(float)
    far = 1e3 * np.random.default_rng(0).normal(size=(40, 2))
    commands, _ = sent(begun(made[name]), far, np.ones(3, bool))
    assert commands.min() >= recorded.min() - 1e-6
    assert commands.max() <= recorded.max() + 1e-6


def test_a_mixture_with_a_gaussian_that_lost_its_samples_is_fitted_again_with_fewer(monkeypatch):
    """`gmr` divides by 0 where no sample is left to a Gaussian, and NumPy factorises NaN."""
    fitted = []

    class Empty(regression.GMM):
        def from_samples(self, *args, **options):
            super().from_samples(*args, **options)
            fitted.append(self.n_components)
            if self.n_components > 2:
                self.covariances = np.full_like(self.covariances, np.nan)

    monkeypatch.setattr(regression, "GMM", Empty)
    samples = np.random.default_rng(0).normal(size=(200, 3))
    priors, means, covariances = regression._fitted(samples, 8)
    assert fitted == [8, 4, 2]
    assert (len(priors), means.shape, covariances.shape) == (2, (2, 3), (2, 3, 3))
    assert np.isfinite(covariances).all()
