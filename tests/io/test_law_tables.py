"""Keys of a law's table in a case file, derived from the fields of the law."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError, create_model

from cicatrix.cases.laws import LAWS, union_of
from cicatrix.cases.sentences import sentences_of
from cicatrix.cases.table import Table
from cicatrix.core.errors import InputError
from cicatrix.core.law import Law, choice, param
from cicatrix.materials.material import EnergyMaterial, has_bulk_modulus
from cicatrix.materials.neo_hookean import NeoHookean


class Even(Law):
    low: float = param("1", "low", low=1.0)
    high: float = param("1", "high", low=1.0)

    def __check_init__(self):
        if not self.low < self.high:
            raise InputError("Even.low must be below high.")


class Straight(Law):
    """Waviness without parameters."""


class Turning(EnergyMaterial):
    """A law with every kind of field."""

    mean: float = param("rad", "theta", low=0.0, high=math.pi, typed="deg")
    tau: float = param("s", "tau", low=0.0, typed="h")
    rate: float = param("1/s", "k", low=0.0, default=1.0, typed="1/h")
    viscosity: float = param("kPa s", "eta", default=0.0)
    powers: tuple[float, ...] = param("1", "alpha", low=-10.0, default=(1.0,))
    waviness: Even | Straight | None = choice({"even": Even, "straight": Straight}, default=None)
    base: NeoHookean | None = None
    n_angles: int = 8


class Stack(EnergyMaterial):
    """Law that contains a list of laws."""

    layers: tuple[EnergyMaterial, ...]
    thickness: float = param("mm", "h", low=0.0, typed="um", default=1.0)


TYPES = {"turning": Turning, "stack": Stack, "neo-hookean": NeoHookean}
Case = create_model("Case", __base__=Table, law=(tuple[union_of(TYPES), ...], ...))
TURNING = {"type": "turning", "mean_deg": 90, "tau_h": 2}


def built(**keys):
    return Case.model_validate({"law": [{**TURNING, **keys}]}).law[0].build()


def sentences(*laws):
    with pytest.raises(ValidationError) as error:
        Case.model_validate({"law": list(laws)})
    return sentences_of(error.value, Case)


def test_what_is_typed_is_what_the_law_counts_in():
    law = built(rate_per_h=7200, viscosity_kPa_s=3)
    assert (law.mean, law.tau, law.rate, law.viscosity) == (pytest.approx(math.pi / 2), 7200.0, pytest.approx(2.0), 3.0)
    assert built().rate == 1.0  # the law's own default, in its own unit
    assert isinstance(built().n_angles, int)


def test_lists_tables_and_types():
    law = built(powers=[2, -3], waviness={"type": "even", "low": 1.0, "high": 1.4}, base={"mu_kPa": 1.5})
    assert law.powers == (2.0, -3.0)
    assert isinstance(law.waviness, Even)
    assert (law.waviness.high, law.base.mu) == (1.4, 1.5)
    assert built().waviness is None


def test_laws_of_laws():
    inner = {"type": "neo-hookean", "mu_kPa": 2, "kappa_kPa": 4}
    table = {"type": "stack", "thickness_um": 500, "layers": [inner, {"type": "stack", "layers": [inner]}]}
    law = Case.model_validate({"law": [table]}).law[0].build()
    assert law.thickness == pytest.approx(0.5)
    assert law.layers[1].layers[0].mu == 2.0
    assert has_bulk_modulus(law)
    assert not has_bulk_modulus(Stack((NeoHookean(1.0),)))


def test_faults_name_their_place_wherever_it_is():
    deep = {"type": "stack", "layers": [{"type": "neo-hookean", "mu_kPa": -1}]}
    assert sentences(deep) == ["law[0].layers[0].mu_kPa must be at least 0; got -1"]
    assert sentences({**TURNING, "mean_deg": 270}) == ["law[0].mean_deg must be at least 0 and at most 180; got 270"]
    assert sentences({**TURNING, "mean": 1.0}) == ["law[0].mean is not a known key; did you mean law[0].mean_deg?"]
    assert sentences({**TURNING, "powers": [1, -20]}) == ["law[0].powers[1] must be at least -10; got -20"]
    wavy = {**TURNING, "waviness": {"type": "even", "low": 0.5, "high": 1.4, "hihg": 3}}
    assert sentences(wavy) == [
        "law[0].waviness.low must be at least 1; got 0.5",
        "law[0].waviness.hihg is not a known key; did you mean law[0].waviness.high?",
    ]
    odd = {**TURNING, "waviness": {"type": "odd"}}
    assert sentences(odd) == ['law[0].waviness.type must be "even" or "straight"; got "odd"']
    assert sentences({**TURNING, "n_angles": 2.5}) == ["law[0].n_angles must be a whole number; got 2.5"]
    assert sentences({**TURNING, "base": 3}) == ["law[0].base must be a table; got 3"]


def test_values_that_do_not_go_together_are_refused_by_the_law():
    with pytest.raises(InputError, match="must be below high"):
        built(waviness={"type": "even", "low": 1.4, "high": 1.2})


def test_every_law_of_case_files_has_a_table():
    union_of(LAWS)
