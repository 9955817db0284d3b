import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxreplay import Params
from jaxreplay.errors import ConfigError


@given(
    theta_i=st.floats(0, 1),
    theta_tau=st.floats(0, 0.5),
    sigma=st.lists(st.floats(1e-30, 1e30), min_size=1),
)
def test_values_in_range_are_kept_in_the_working_precision(theta_i, theta_tau, sigma):
    params = Params(theta_i, theta_tau, sigma)
    for leaf, value in zip(jax.tree.leaves(params), (theta_i, theta_tau, sigma), strict=True):
        assert leaf.dtype == "float32"
        np.testing.assert_array_equal(leaf, np.asarray(value, np.float32))
    with jax.enable_x64(True):
        np.testing.assert_array_equal(Params(theta_i, theta_tau, sigma).sigma, sigma)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"theta_i": -1e-6}, r"theta_i \(θ_I\) must be in \[0, 1\]; got -(1|9\.9+\d*)e-0[67]"),
        ({"theta_i": 1.001}, r"theta_i \(θ_I\) must be in \[0, 1\]; got 1.001"),
        ({"theta_i": np.nan}, r"theta_i \(θ_I\) must be in \[0, 1\]; got nan"),
        ({"theta_i": [0.5, 2.0]}, r"theta_i \(θ_I\) must be in \[0, 1\]; got 2"),
        ({"theta_tau": -0.1}, r"theta_tau \(θ_τ\) must be in \[0, 0.5\]; got -0.1"),
        ({"theta_tau": 0.501}, r"theta_tau \(θ_τ\) must be in \[0, 0.5\]; got 0.50[01]"),
        ({"theta_tau": np.nan}, r"theta_tau \(θ_τ\) must be in \[0, 0.5\]; got nan"),
        ({"sigma": [1.0, 0.0]}, r"sigma \(σ\) must be > 0 and finite; got 0"),
        ({"sigma": [-3.0, 1.0]}, r"sigma \(σ\) must be > 0 and finite; got -3"),
        ({"sigma": [1.0, np.nan]}, r"sigma \(σ\) must be > 0 and finite; got nan"),
        ({"sigma": [1.0, np.inf]}, r"sigma \(σ\) must be > 0 and finite; got inf"),
        ({"sigma": [[1.0, 1.0], [1.0, -2.0]]}, r"sigma \(σ\) must be > 0 and finite; got -2"),
        ({"sigma": 1.0}, r"sigma \(σ\) needs one value per sensor"),
    ],
)
def test_a_value_out_of_range_is_an_error(values, message):
    with pytest.raises(ValueError, match=message):
        Params(**{"theta_i": 0.1, "theta_tau": 0.05, "sigma": [1.0, 2.0]} | values)


@pytest.mark.parametrize("name", ["theta_i", "theta_tau", "sigma"])
@pytest.mark.parametrize("value", ["many", None, object(), [0.1, "b"], [[0.1], [0.1, 0.2]], {}])
def test_what_is_no_number_is_an_error(name, value):
    values = {"theta_i": 0.1, "theta_tau": 0.05, "sigma": [1.0]} | {name: value}
    with pytest.raises(ValueError, match=f"{name} is not a number or an array of numbers"):
        Params(**values)


def test_sigma_too_small_for_the_working_precision_is_an_error():
    with pytest.raises(ValueError, match=r"sigma \(σ\) must be > 0"):
        Params(0.1, 0.05, [1e-60])


def total(theta_i, theta_tau, sigma):
    return sum(leaf.sum() for leaf in jax.tree.leaves(Params(theta_i, theta_tau, sigma)))


def test_traced_values_pass_whatever_they_are():
    values = jnp.float32(-1), jnp.float32(7), jnp.array([-2.0, 0.0])
    assert jax.jit(total)(*values) == 4
    batch = [jnp.stack([value, value]) for value in values]
    assert jax.vmap(total)(*batch).tolist() == [4, 4]
    gradients = jax.grad(total, argnums=(0, 1, 2))(*values)
    assert [gradient.tolist() for gradient in gradients] == [1, 1, [1, 1]]


def test_params_pass_through_jit_vmap_and_grad():
    params = Params([0.0, 0.5], [0.0, 0.25], [[1.0, 2.0], [3.0, 4.0]])
    rows = jax.vmap(lambda p: p.theta_i + p.theta_tau + p.sigma.sum())(params)
    assert rows.tolist() == [3, 7.75]
    doubled = jax.jit(lambda p: jax.tree.map(lambda leaf: 2 * leaf, p))(params)
    assert doubled.sigma.tolist() == [[2, 4], [6, 8]]
    gradient = jax.grad(lambda p: (p.sigma**2).sum() - p.theta_i.sum())(params)
    assert isinstance(gradient, Params)  # of values that no Params may have
    assert gradient.theta_i.tolist() == [-1, -1]
    assert gradient.sigma.tolist() == [[2, 4], [6, 8]]


@pytest.mark.parametrize("leaf", [None, -1, "text", object()])
def test_any_leaf_survives_the_pytree_roundtrip(leaf):
    structure = jax.tree.structure(Params(0.1, 0.05, [1.0]))
    params = jax.tree.unflatten(structure, [leaf] * 3)
    assert params.theta_i is params.theta_tau is params.sigma is leaf
    leaves = jax.tree.leaves(params, is_leaf=lambda x: x is None)
    assert all(value is leaf for value in leaves)
    assert len(leaves) == 3


def test_leaves_are_named_after_the_parameters():
    paths = jax.tree_util.tree_leaves_with_path(Params(0.1, 0.05, [1.0]))
    named = {jax.tree_util.keystr(path): leaf.shape for path, leaf in paths}
    assert named == {".theta_i": (), ".theta_tau": (), ".sigma": (1,)}


TUNED = """
# Parameters tuned on "demos.npz"
theta_i = 0.01  # a comment
theta_tau = 0.05

[sigma]  # in the sensors' units
"north" = 2
"a b.c" = 0.125
"""


def test_a_tuned_file_is_read_in_the_order_of_its_sensors(tmp_path):
    path = tmp_path / "tuned.toml"
    path.write_text(TUNED)
    for each in (path, str(path)):
        params = Params.load(each)
        assert params.theta_i == np.float32(0.01)
        assert params.theta_tau == np.float32(0.05)
        assert params.sigma.tolist() == [2, 0.125]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (TUNED, None, "cannot be read: No such file or directory"),
        ("theta_tau =", "theta_tau", "is not TOML: "),
        ("# a comment", "\xff", "is not TOML: "),
        ("theta_tau = 0.05", "", "theta_tau is missing; jaxreplay tune writes"),
        (TUNED, "theta_i = 0.1\ntheta_tau = 0.1", "sigma is missing"),
        (TUNED, "theta_j = 0.1", "unknown key theta_j; did you mean theta_i?"),
        ("0.01", '"0.01"', "theta_i must be a number; got '0.01'"),
        ("0.01", "true", "theta_i must be a number; got True"),
        ("0.125", "[1, 2]", r"sigma\.a b\.c must be a number; got \[1, 2\]"),
        ("0.125", "-1", r"sigma \(σ\) must be > 0 and finite; got -1"),
        ("0.01", "1.5", r"theta_i \(θ_I\) must be in \[0, 1\]; got 1.5"),
        ("0.01", f"1{400 * '0'}", "tuned.toml: "),
        (TUNED, "theta_i = 0\ntheta_tau = 0\nsigma = 0.1", r"sigma must be a table, \[sigma\]"),
        (TUNED, "theta_i = 0\ntheta_tau = 0\n[sigma]", r"sigma must be a table, \[sigma\]"),
    ],
)
def test_a_mistake_in_a_tuned_file_is_one_line(tmp_path, old, new, message):
    path = tmp_path / "tuned.toml"
    if new is not None:
        path.write_text(TUNED.replace(old, new), encoding="latin-1")
    with pytest.raises(ConfigError, match=message) as raised:
        Params.load(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)
