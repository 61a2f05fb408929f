"""Signalling networks: normalised Hill functions, gates and rules, all compared with numbers by hand."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cicatrix.biology.network import HillNetwork
from cicatrix.biology.rules import RuleFactor, parse_rule
from cicatrix.biology.wiring import Wiring
from cicatrix.core.errors import InputError


def network(*rules, species="ABCD", tau=3600.0, **changed):
    """Return a network of species A to D, with weight 1, n 1.4 and EC50 0.6 everywhere unless ``changed`` says otherwise."""
    m = len(rules)
    wiring = Wiring(tuple(species), tuple(f"r{i}" for i in range(m)), tuple(map(parse_rule, rules)))
    given = {"weight": 1.0, "n": 1.4, "ec50": 0.6, "y_max": 1.0} | changed
    shapes = {"weight": m, "n": m, "ec50": m, "y_max": len(species)}
    arrays = {key: np.broadcast_to(np.asarray(given[key], float), size).copy() for key, size in shapes.items()}
    return HillNetwork(
        wiring, tau=np.full(len(species), tau), inhibition=changed.get("inhibition", "complement"), **arrays
    )


def driven(law, inputs=None, **y):
    """Return F of every species."""
    state = np.array([y.get(name, 0.0) for name in law.species])
    return dict(zip(law.species, np.asarray(law.activation(state, inputs))))


def printed(x, w, n, ec50):
    """Return the normalised Hill function as printed, with its quotients."""
    B = (ec50**n - 1.0) / (2.0 * ec50**n - 1.0)
    return w * B * x**n / (B - 1.0 + x**n)


@pytest.mark.parametrize(("w", "n", "ec50"), [(1.0, 1.4, 0.6), (0.4, 1.4, 0.5), (0.7, 4.0, 0.8), (1.0, 1.0, 0.3)])
def test_activation_is_0_half_and_whole(w, n, ec50):
    law = network("A => B", weight=w, n=n, ec50=ec50)
    values = [driven(law, A=x)["B"] for x in (0.0, ec50, 1.0)]
    np.testing.assert_allclose(values, [0.0, w / 2, w], atol=1e-14)
    for x in (0.1, 0.45, 0.9, 1.7):
        assert driven(law, A=x)["B"] == pytest.approx(printed(x, w, n, ec50), rel=1e-13)


@pytest.mark.parametrize(("n", "ec50"), [(1.25, 0.6), (1.4, 0.7), (1.0, 0.999), (3.0, 0.95)])
def test_above_one_half_act_is_as_printed_on_0_to_1(n, ec50):
    """Its pole, where K^n + x^n = 0, is above 1."""
    assert ((ec50**n) / (2 * ec50**n - 1)) ** (1 / n) > 1.0
    law = network("A => B", n=n, ec50=ec50, weight=0.8)
    for x in (0.0, 0.01, 0.3, ec50, 0.9, 1.0):
        assert driven(law, A=x)["B"] == pytest.approx(printed(x, 0.8, n, ec50), rel=1e-12, abs=1e-15)
    for x in (1.01, 1.5, 40.0):  # beyond it counts as 1, at the pole and behind it too
        assert driven(law, A=x)["B"] == pytest.approx(0.8, rel=1e-5)
    slope = float(jax.grad(lambda x: law.activation(jnp.array([x, 0.0, 0.0, 0.0]))[1])(1.0))
    assert slope == pytest.approx((printed(1.0, 0.8, n, ec50) - printed(1 - 1e-7, 0.8, n, ec50)) / 1e-7, rel=1e-3)


def test_at_one_half_act_is_the_power():
    """By hand: w (1 - H) x^n / (H + (1 - 2 H) x^n) with H = 1/2 is w x^n, the limit of the printed function."""
    law = network("A => B", n=2.0, ec50=0.5**0.5, weight=0.8)
    for x in (0.2, 0.5**0.5, 1.0):
        assert driven(law, A=x)["B"] == pytest.approx(0.8 * x**2, rel=1e-12)


def test_a_species_above_1_is_told_where_act_has_a_pole():
    law = network("A => B", "C => B", n=1.25, ec50=[0.6, 0.5], y_max=[2.0, 1.0, 3.0, 1.0])
    assert law.saturating(law.y_max) == ("A",)


def test_gates_by_hand():
    h = printed(0.3, 1.0, 1.4, 0.6), printed(0.8, 1.0, 1.4, 0.6)
    assert driven(network("A & B => C"), A=0.3, B=0.8)["C"] == pytest.approx(h[0] * h[1])
    assert driven(network("A => C", "B => C"), A=0.3, B=0.8)["C"] == pytest.approx(h[0] + h[1] - h[0] * h[1])
    assert driven(network("!A => C"), A=0.3)["C"] == pytest.approx(1.0 - h[0])
    assert driven(network("A & !B => C"), A=0.3, B=0.8)["C"] == pytest.approx(h[0] * (1.0 - h[1]))
    three = driven(network("A => D", "B => D", "=> D", weight=[1.0, 1.0, 0.5]), A=0.3, B=0.8)["D"]
    assert three == pytest.approx(1.0 - (1.0 - h[0]) * (1.0 - h[1]) * 0.5)


@pytest.mark.parametrize("w", [0.0, 0.3, 1.0])
def test_weights_of_gates(w):
    """AND is a product over w^(m-1), here 0.3; NOT is 1 - act or, in Netflux, w - act."""
    a, b = printed(0.3, 1.0, 1.4, 0.6), printed(0.8, 1.0, 1.4, 0.6)
    assert driven(network("A & B => C", weight=w), A=0.3, B=0.8)["C"] == pytest.approx(w * a * b)
    assert driven(network("A & !B => C", weight=w), A=0.3, B=0.8)["C"] == pytest.approx(a * (1.0 - w * b))
    weighted = network("A & !B => C", weight=w, inhibition="weighted")
    assert driven(weighted, A=0.3, B=0.8)["C"] == pytest.approx(w * a * (1.0 - b))
    if w:
        two = network("A & !B & !C => D", weight=w)
        expected = w * a * (1 - w * b) * (1 - w * a) / w**2
        assert driven(two, A=0.3, B=0.8, C=0.3)["D"] == pytest.approx(expected)


def test_inputs_take_the_place_of_weights():
    law = network("=> A", "A => B", "=> C", weight=[0.25, 1.0, 0.5])
    assert law.input_names == ("A", "C")
    assert (driven(law)["A"], driven(law)["C"]) == (0.25, 0.5)
    assert driven(law, np.array([0.7, 0.1]))["A"] == pytest.approx(0.7)
    rate = law.rate(np.zeros(4), np.array([0.7, 0.1]))
    np.testing.assert_allclose(rate, np.array([0.7, 0.0, 0.1, 0.0]) / 3600.0)


def test_rate_follows_its_target():
    law = network("A => B", y_max=[1.0, 0.5, 1.0, 1.0], tau=100.0)
    rate = np.asarray(law.rate(np.array([1.0, 0.2, 0.4, 0.0])))
    np.testing.assert_allclose(rate, [-0.01, (0.5 - 0.2) / 100.0, -0.004, 0.0], atol=1e-16)


def test_batches_broadcast():
    rng = np.random.default_rng(1)
    rules = ("=> A", "A & !B => C", "C => B", "A => B", "!C => D")
    law, y, inputs = network(*rules, weight=0.8), rng.random((5, 3, 4)), rng.random((3, 1))
    one = eqx.filter_jit(lambda law, y, inputs: law.rate(y, inputs))
    together = np.asarray(one(law, y, inputs))
    for i, j in np.ndindex(5, 3):
        np.testing.assert_allclose(together[i, j], one(law, y[i, j], inputs[j]), rtol=1e-12)
    sets = rng.uniform(0.5, 1.0, (7, 5))
    varied = HillNetwork(law.wiring, law.y_max, law.tau, sets, law.n, law.ec50)
    many = np.asarray(one(varied, y[0, 0], inputs[0]))
    for k in range(7):
        alone = one(network(*rules, weight=sets[k]), y[0, 0], inputs[0])
        np.testing.assert_allclose(many[k], alone, rtol=1e-12)


def test_derivatives_are_those_of_differences(slope):
    law = network("=> A", "A & !B => C", "C => B", "A => B", "!C & !A => D", weight=[0.3, 0.8, 0.7, 1.0, 0.9])
    y = np.array([0.3, 0.6, 0.2, 0.9])
    rate = jax.jit(lambda y: law.rate(y) * 3600.0)
    slopes = jax.jit(jax.jacobian(rate))
    J = slopes(jnp.asarray(y))
    for k in range(4):
        column = slope(lambda h, k=k: np.asarray(rate(y + h * np.eye(4)[k])), 1e-3)
        np.testing.assert_allclose(J[:, k], column, atol=1e-8)

    @jax.jit
    def of(ec50):
        return HillNetwork(law.wiring, law.y_max, law.tau, law.weight, law.n, ec50).rate(y) * 3600.0

    by_ec50 = jax.jit(jax.jacobian(of))(jnp.asarray(law.ec50))
    for k in range(5):
        column = slope(lambda h, k=k: np.asarray(of(law.ec50 + h * np.eye(5)[k])), 1e-3)
        np.testing.assert_allclose(by_ec50[:, k], column, atol=1e-8)
    assert np.isfinite(slopes(jnp.zeros(4))).all()  # at 0, where powers have no logarithm


def test_negative_activities_count_as_0():
    law = network("A => B", "!A => C")
    np.testing.assert_array_equal(law.activation(np.array([-0.01, 0, 0, 0])), law.activation(np.zeros(4)))


def test_rules_are_read():
    rule = parse_rule(" TGFB &!smad7=> smad3 ")
    assert rule.factors == (RuleFactor("TGFB", False), RuleFactor("smad7", True))
    assert (rule.target, rule.is_input, str(rule)) == ("smad3", False, "TGFB & !smad7 => smad3")
    assert parse_rule("=> TGFB").is_input


@pytest.mark.parametrize(
    "text",
    [
        "CREB & !CBP => IL6",
        "CREB + !CBP => IL6",
        "CREB AND NOT CBP -> IL6",
        "CREB&!CBP==>IL6",
        "CREB & ! CBP \u21d2 IL6",
    ],
)
def test_rules_are_read_as_netflux_writes_them(text):
    assert str(parse_rule(text)) == "CREB & !CBP => IL6"


def test_species_may_be_called_like_words():
    rule = parse_rule("ANDROGEN & NOTCH => ORAI1")
    assert (rule.factors, rule.target) == ((RuleFactor("ANDROGEN", False), RuleFactor("NOTCH", False)), "ORAI1")


def test_reactions_with_the_same_rule_are_found():
    law = network("A & !B => C", "A => C", "!B & A => C", "=> A", "A => B")
    assert [pair[:2] for pair in law.wiring.repeated] == [("r0", "r2")]


RULES = {
    "TGFB && smad3 => x": 'at column 7: a species expected, found "&" (AND is a single &)',
    "TGFB smad3 => x": 'at column 6: "&" or "=>" expected, found "smad3"',
    "TGFB | smad3 => x": 'at column 6: "&" or "=>" expected, found "|" (OR is two reactions with the same target)',
    "TGFB =>": "at column 8: a species expected, found its end",
    "TGFB": 'at column 5: "&" or "=>" expected, found its end',
    "": "at column 1: a species expected, found its end",
    "TGFB => a & b": 'at column 11: one target and then the end of the rule expected, found "&"',
    "!!a => b": 'at column 2: a species expected, found "!"',
    "a = b": 'at column 3: "&" or "=>" expected, found "=" (an arrow is written =>)',
    "a OR b => c": 'at column 3: "&" or "=>" expected, found "OR" (OR is two reactions with the same target)',
    "TGF-b => c": 'at column 4: "&" or "=>" expected, found "-" (a species is written with letters, digits and _)',
    "NOT => c": 'at column 5: a species expected, found "=>"',
    "a => !b": 'at column 6: a species expected, found "!"',
}


@pytest.mark.parametrize("text", RULES)
def test_a_rule_that_does_not_parse_says_where(text):
    with pytest.raises(InputError) as error:
        parse_rule(text)
    assert str(error.value) == f'has the rule "{text}", which does not parse {RULES[text]}'


FAULTS = {
    "unknown": (["AA => B"], {}, 'reaction "r0" names the unknown species "AA"; did you mean "A"?'),
    "far": (["xyz => B"], {}, 'reaction "r0" names the unknown species "xyz"; known: A, B, C, D'),
    "two inputs": (["=> A", "=> A"], {}, 'input "A" is listed twice'),
    "ec50": (["A => B"], {"ec50": 1.0}, 'reaction "r0": ec50 must be above 0 and below 1; got 1'),
    "ec50 of 0": (["A => B"], {"ec50": 0.0}, 'reaction "r0": ec50 must be above 0 and below'),
    "n": (["A => B", "B => C"], {"n": [2.0, 0.9]}, 'reaction "r1": n must be in [1, 50]; got 0.9'),
    "weight": (["A => B"], {"weight": 1.5}, 'reaction "r0": weight must be in [0, 1]; got 1.5'),
    "nan": (["A => B"], {"weight": np.nan}, 'reaction "r0": weight must be in [0, 1]; got nan'),
    "tau": (["A => B"], {"tau": 0.0}, 'species "A": tau must be above 0 s; got 0'),
    "y_max": (["A => B"], {"y_max": -1.0}, 'species "A": y_max must be at least 0; got -1'),
    "0 / 0": (
        ["A & !B & !C => D"],
        {"weight": 0.0},
        'reaction "r0": weight must be above 0 in an AND of two inhibitors',
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_out_of_range_is_named(name):
    rules, changed, sentence = FAULTS[name]
    with pytest.raises(InputError) as error:
        network(*rules, **changed)
    assert str(error.value).startswith(sentence)
