"""Units of radiance: their size by hand, in any order and spelling; and what is none."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from texnet.files.units import UNIT_NAMES, UNITS, unit_of

WATTS = {"W": 1.0, "mW": 1e-3, "uW": 1e-6, "nW": 1e-9}
AREAS = {"m": 1.0, "cm": 1e4}  # per area, in per m2
PER_UM = {"um": 1.0, "nm": 1e3}


@pytest.mark.parametrize("name", UNIT_NAMES)
def test_names_mean_themselves(name):
    assert unit_of(name) == unit_of(name.lower()) == unit_of(f" {{{name}}}") == name


@given(
    st.sampled_from(list(WATTS)), st.sampled_from(list(AREAS)),
    st.sampled_from([*PER_UM, "cm-1"]), st.permutations(range(4)),
    st.sampled_from([" ", "*", ".", "\u00b7", " * "]), st.sampled_from(["", "^"]),
)  # fmt: skip
def test_a_product_of_powers_in_any_order_is_the_unit_of_its_size(
    watts, area, density, order, times, power
):
    per_cm1 = density == "cm-1"
    of = f"(cm{power}-1){power}-1" if per_cm1 else f"{density}{power}-1"
    factors = [watts, f"{area}{power}-2", f"sr{power}-1", of]
    found = unit_of(times.join(factors[i] for i in order))
    size = WATTS[watts] * AREAS[area] * PER_UM.get(density, 1.0)
    there = [u for u, (factor, per) in UNITS.items() if per == per_cm1 and factor == _near(size)]
    assert found in there or not there and found is None


@given(
    st.sampled_from(list(WATTS)), st.sampled_from(list(AREAS)), st.sampled_from(list(PER_UM)),
    st.permutations(range(3)), st.sampled_from(["/", "(*)", "( )", "(.)"]),
)  # fmt: skip
def test_so_is_a_quotient(watts, area, density, order, how):
    below = [[f"{area}^2", "sr", density][i] for i in order]
    said = f"{watts}/({how[1].join(below)})" if how != "/" else "/".join([watts, *below])
    size = WATTS[watts] * AREAS[area] * PER_UM[density]
    there = [u for u, (factor, per) in UNITS.items() if not per and factor == _near(size)]
    assert unit_of(said) in there or not there and unit_of(said) is None


def _near(size):
    return pytest.approx(size, rel=1e-6)


@pytest.mark.parametrize(
    ("said", "name"),
    [
        ("Watts/m^2/sr/micron", "W/m2/sr/um"),
        ("W\u00b7m\u207b\u00b2\u00b7sr\u207b\u00b9\u00b7\u00b5m\u207b\u00b9", "W/m2/sr/um"),
        ("W/m2/um/steradian", "W/m2/sr/um"), ("uW/cm^2/nm/sr", "uW/cm2/sr/nm"),
        ("uFlick", "microflick"), ("micro-flicks", "microflick"), ("flick", "W/cm2/sr/um"),
        ("W/(m2 sr cm-1)", "W/m2/sr/cm-1"), ("W/(cm2*sr*cm-1)", "W/cm2/sr/cm-1"),
        ("W m-2 sr-1 (cm-1)-1", "W/m2/sr/cm-1"),
        ("(W/m2/sr/um)", "W/m2/sr/um"), ("W/m^(2)/sr/um", "W/m2/sr/um"), ("(K)", "K"),
        ("Kelvin", "K"), ("kelvins", "K"),
    ],
)  # fmt: skip
def test_what_people_write(said, name):
    assert unit_of(said) == name


@pytest.mark.parametrize(
    "said",
    ["", "DN", "counts", "reflectance", "W", "W/m2", "W/m2/sr", "W/m2/um", "W2/m2/sr/um", "sr",
     "W/m2/sr/um/um", "m/W/sr", "J/m2/sr/um", "W/m2/sr/kg", "1e-6 W/m2/sr/um", "W/(m2", "C", "K/m",
     "W/cm2/sr um", "W/cm2/sr*um", "W/(cm2 sr) um", "W cm-2 sr-1 um-1 m", "mW/cm2/sr um",
     "W cm-2 sr-1 cm-1", "W/cm2/sr/cm", "W m-2 sr-1 cm-1", "W/m2/sr/m", "flick/um", "flick2"],
)  # fmt: skip
def test_what_is_no_radiance(said):
    assert unit_of(said) is None
