"""Check that every default has a source and that units are converted in one place."""

import pytest

from cicatrix.core import units
from cicatrix.kinds.lumpectomy.case import ImageTable, LumpectomyCase, TissueTable, TumourTable
from cicatrix.kinds.lumpectomy.sources import SOURCES, keys, value_at

CASE = LumpectomyCase(image=ImageTable(phantom="half-ellipsoid"))


def test_every_tissue_and_healing_number_has_a_source():
    asked = {key for key in keys(CASE) if key.split(".")[0] in ("tissue", "healing")} - {"healing.model"}
    assert asked <= SOURCES.keys() <= set(keys(CASE))


def test_changed_value_is_not_given_the_source_of_the_default():
    case = CASE.model_copy(update={"tissue": TissueTable(tumour=TumourTable(E_kPa=30.0))})
    assert case.sources()["tissue.tumour.E_kPa"] == "given by the case"
    assert "6 times gland" in CASE.sources()["tissue.tumour.E_kPa"]


def test_defaults_follow_their_sources():
    assert value_at(CASE, "tissue.scar.E_kPa") == pytest.approx(0.58)  # 0.3 * 29 / 15 by hand
    assert value_at(CASE, "tissue.tumour.E_kPa") == pytest.approx(2.16)  # 6 * 1.2 * 0.3
    assert CASE.days_per_step == 0.625  # 15 h


def test_step_length_scales_with_the_pitch():
    def at(pitch_um, dimension):
        healing = CASE.healing.model_copy(update={"pitch_um": pitch_um})
        return CASE.unchecked(healing=healing, dimension=dimension).days_per_step  # the finest pitches fill the memory

    assert [at(pitch, 2) for pitch in (40.0, 50.0, 200.0)] == [2.5, 3.125, 3.125]
    # half a site of 84 um in two cell cycles' 42 um
    assert at(84.0, 3) == pytest.approx(0.625)


def test_units():
    # weight of 1 ml of water by hand: 1000 kg/m3 * 1000 mm3 * 9.80665 m/s2 = 9.80665 mN
    weight = units.density_kg_mm3(1000.0) * 1000.0 * units.acceleration_mm_s2(units.STANDARD_GRAVITY_M_S2)
    assert weight == pytest.approx(9.80665)
    assert units.weeks_from_days(units.days_from_weeks(26.0)) == 26.0
    assert units.hours_from_days(units.days_from_hours(15.0)) == 15.0
    assert units.um_from_mm(units.mm_from_um(10.0)) == pytest.approx(10.0)
    assert units.ml_from_mm3(55_000.0) == pytest.approx(55.0)
