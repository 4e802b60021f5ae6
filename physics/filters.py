"""Which N filters tell materials and temperatures apart best, for a library and its scenes.

Camera. A snapshot camera: N filters of one width w over equal detectors that are exposed
together. The noise is the detector's own, so what the filter lets through does not change it:
twice the width, twice the signal,

    NETD = NETD_K (1 um / w),       the same in every filter, as in a HeatCube.

The last filter ends at 14 um, where carbon dioxide makes the air opaque: there a sky shows the
air's temperature, without which `estimate` cannot tell a sky from a mirror. Where the library ends
before, so do the filters. Beyond that the design takes the surroundings as known, up to ERROR_K;
with few filters the cube may not show them.

Scenes. A fixed draw of T, of surroundings (a clear sky at three heights, under several amounts
of water vapour, and ground colder and warmer than the air) and of V, uniform on the simplex.

Error. A pixel of material m looks, in noise units, s_m - s_m' away from what material m' would
look like there. By other T and V, and by what the k objects say wrongly of its surroundings, m'
comes nearer along its Jacobian J (`identifiability`), as far as the prior P of those unknowns
lets it:

    d^2 = min over x of |s_m - s_m' - J x|^2 + x' P^-1 x

Between two normal distributions d apart the Bhattacharyya coefficient is exp(-d^2 / 8), and what
is left to know of m, all materials being as likely, is then at most

    H = mean over m of ln sum over m' of exp(-d^2 / 8)    nats

(Kolchinsky and Tracey 2017, Entropy 19, 361; with T and V unknown, as here, a figure of merit and
no bound). T, given m, has no smaller variance sigma_T^2 than the first element of
(J'J + P^-1)^-1: the Cramer-Rao bound with a prior (Van Trees 1968). What is left to know of T at a
resolution of TOLERANCE_K is ln(1 + sigma_T^2 / TOLERANCE_K^2) / 2, and the figure to be least is

    loss = mean over scenes of H + mean over m of ln(1 + sigma_T^2 / TOLERANCE_K^2) / 2.

An added filter is a step of recursive least squares, which raises every d^2 and lowers every
sigma_T: more filters are never worse, as long as one more of that width has a place.

Search. The best design of one filter less and one filter more, and N filters side by side, are
both improved by exchanges, a filter to another place or all filters to another width, until no
single exchange helps: a local optimum, no worse than filters side by side, the same every time.
"""

from typing import NamedTuple

import numpy as np

from .bands import equidistant_bands
from .eq1 import render
from .errors import InputError
from .estimate import ERROR_K
from .identifiability import jacobian
from .library import SKY
from .planck import noise_sigma, planck
from .prior import MIN_TEMPERATURE_SPREAD_K
from .sky import sky_radiance, usual_atmosphere

NETD_K = 0.05  # of a filter 1 um wide, at 300 K
TOLERANCE_K = 0.5  # what the surroundings leave of T's error on simulated scenes
LOW_UM, HIGH_UM, STEP_UM = 8.0, 14.0, 0.1
FINE_UM = LOW_UM + STEP_UM * (np.arange(round((HIGH_UM - LOW_UM) / STEP_UM)) + 0.5)
WIDTHS_UM = (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0)
LEAST = 3  # with fewer, `estimate` cannot tell a sky from a grey body
LEAST_UM = 3.0  # of a library's range
DRAWS, SEED = 32, 0
HUMIDITY = (0.25, 0.5, 0.75, 1.0)  # of vapour over what the air can hold
COS_ZENITH = (1.0, 0.5, 0.15)
GROUND_K = ((-5.0,), (5.0,))  # about the ground's mean
GAIN = 1e-9  # nats; an exchange that gains less is rounding


class Scenes(NamedTuple):
    """temperature_k (D,) K; environment (D, k, fine) W m-2 sr-1 um-1 at FINE_UM; lighting (D, k),
    V on the simplex."""

    temperature_k: np.ndarray
    environment: np.ndarray
    lighting: np.ndarray


class Filters(NamedTuple):
    """N filters of one width, and what to expect of them.

    wavelength_um (N,) centres, ascending;  fwhm_um (N,);  netd_k  K at 300 K
    loss           nats, as in the module;  material_loss: H alone
    temperature_k  median of sigma_T over scenes and materials, K
    """

    wavelength_um: np.ndarray
    fwhm_um: np.ndarray
    netd_k: float
    loss: float
    material_loss: float
    temperature_k: float


def draw_scenes():
    """Clear nights and surfaces of 265-310 K, the same every time."""
    rng = np.random.default_rng(SEED)
    air = rng.uniform(275, 300, DRAWS)
    ground = air + rng.normal(0, 3, DRAWS)
    airs = map(usual_atmosphere, air, np.resize(HUMIDITY, DRAWS))
    sky = [sky_radiance(FINE_UM, COS_ZENITH, a) for a in airs]
    ground = planck(FINE_UM, (ground + np.array(GROUND_K)).T[..., None])
    environment = np.concatenate([sky, ground], axis=1)
    lighting = rng.dirichlet(np.ones(environment.shape[1]), DRAWS)
    return Scenes(air + rng.normal(0, 5, DRAWS), environment, lighting)


def design_filters(library, n, scenes=None, progress=None):
    """The n filters of least expected loss, all of one width up to 2 um -> Filters.

    library   MaterialLibrary; its sky is left out
    scenes    Scenes; those of draw_scenes() if None
    progress  called as progress(done, total, what)

    Raises InputError where the library holds no material but the sky or covers less than LEAST_UM
    of 8-14 um, or n is no whole number, less than LEAST or more than the library's range holds.
    """
    model, best = _Model(library, scenes), None
    if not isinstance(n, (int, np.integer)) or n < LEAST:
        raise InputError(f"bands: n must be a whole number, at least {LEAST}, got {n}.")
    most = round((model.high - model.low) / STEP_UM)
    if n > most:
        raise InputError(
            f"bands: only {most} filters fit {model.low:g}-{model.high:g} um, got {n}."
        )
    for m in range(1, n + 1):
        starts = [model.side_by_side(m)]
        if best is not None:
            starts += model.grow(*best)
        best = min((model.improve(*f) for f in starts), key=lambda f: model.loss(*f))
        if progress is not None:
            progress(m, n, "filters")
    return model.rate(*best)


def rate_filters(library, wavelength_um, width_um, scenes=None):
    """Filters of centres (N,) and of one width, um, with what to expect of them.

    Raises InputError where the library does not do for design_filters, or a filter has no width or
    reaches beyond filter_range(library).
    """
    model, half = _Model(library, scenes), width_um / 2 - 1e-9
    if not (len(wavelength_um) and 0 < width_um < np.inf):
        raise InputError(f"bands: need one filter or more, of a width above 0, got {width_um} um.")
    if min(wavelength_um) - half < model.low or max(wavelength_um) + half > model.high:
        raise InputError(f"bands: filters must lie within {model.low:g}-{model.high:g} um.")
    return model.rate(list(wavelength_um), width_um)


def filter_range(library):
    """Lowest and highest wavelength of filters for a library, um: what it covers of 8-14 um, in
    whole steps. Raises InputError where that is less than LEAST_UM."""
    edges = LOW_UM + STEP_UM * np.arange(len(FINE_UM) + 1)
    inside = edges[library.covers(edges)].round(9)
    if not inside.size or np.ptp(inside) < LEAST_UM:
        low, high = library.wavelength_um[[0, -1]]
        raise InputError(
            f"library: it covers {low:.4g}-{high:.4g} um; filters need at least {LEAST_UM:g} um "
            f"within {LOW_UM:g}-{HIGH_UM:g} um."
        )
    return float(inside[0]), float(inside[-1])


class _Belief(NamedTuple):
    """What filters so far tell, of D scenes, materials m, hypotheses m' and r unknowns:
    apart (D, m, m') d^2; x (D, m, m', r) the best x; covariance (D, m', r, r) of x."""

    apart: np.ndarray
    x: np.ndarray
    covariance: np.ndarray


class _Model:
    """Signals and Jacobians of all scenes and materials, ready for a filter anywhere."""

    def __init__(self, library, scenes):
        materials = [name for name in library.names if name != SKY]
        if not materials:
            raise InputError("library: it holds only the sky; add materials to design filters for.")
        self.low, self.high = filter_range(library)
        inside = (FINE_UM > self.low) & (FINE_UM < self.high)
        w = FINE_UM[inside]
        e = library.subset(materials).at(w)
        scenes = draw_scenes() if scenes is None else scenes
        # the surroundings are wrong by ERROR_K, from one um to the next independently
        knots = np.arange(LOW_UM, HIGH_UM + 0.5)
        error = np.maximum(0, 1 - np.abs(w[:, None] - knots))
        error = (1 - e)[..., None] * error * noise_sigma(w, ERROR_K)[:, None]
        signal, sensitivity = [], []
        for t, environment, v in zip(*scenes, strict=True):
            t, environment = np.full(len(e), t), environment[:, inside]
            signal.append(render(t, e, v, environment, w)[0])
            j = jacobian(w, 1.0, e, environment, t)
            sensitivity.append(np.concatenate([j, error], axis=2))
        # integrals over wavelength from the lowest to each edge of the fine bands
        self._signal, self._lean = (
            np.cumsum(np.insert(a, 0, 0, axis=2), axis=2) * STEP_UM
            for a in (np.array(signal), np.array(sensitivity))
        )
        (draws, k), m, r = scenes.lighting.shape, len(e), self._lean.shape[-1]
        prior = np.eye(r)
        prior[0, 0] = MIN_TEMPERATURE_SPREAD_K**2
        prior[1:k, 1:k] = (np.eye(k - 1) - 1 / k) / (k * (k + 1))  # uniform on the simplex
        self._nothing = _Belief(
            np.zeros((draws, m, m)), np.zeros((draws, m, m, r)),
            np.broadcast_to(prior, (draws, m, r, r)),
        )  # fmt: skip
        self._seen = {}

    def side_by_side(self, n):
        """Centres and width of n equidistant filters, with gaps where they would be too wide."""
        centres, width = equidistant_bands(n, self.low, self.high)
        return self._fit(centres, min(float(width[0]), WIDTHS_UM[-1]))

    def _fit(self, centres, width):
        """Centres moved so that filters of this width lie within the range and the last ends it."""
        inside = np.clip(centres[:-1], self.low + width / 2, self.high - width / 2)
        return [*inside.tolist(), self.high - width / 2], width

    def grow(self, centres, width):
        """[These filters and the best one more], [] where there is no place."""
        place, loss = self._best_place(centres, width)
        return [(sorted([*centres, place]), width)] if loss < np.inf else []

    def improve(self, centres, width):
        """Exchanges until none helps -> centres, width."""
        loss, before = self.loss(centres, width), np.inf
        while loss < before:
            before = loss
            for centre in centres[:-1]:
                others = [c for c in centres if c != centre]
                place, found = self._best_place(others, width)
                if found < loss - GAIN:
                    centres, loss = sorted([*others, place]), found
            for other in WIDTHS_UM:
                moved, _ = self._fit(centres, other)
                if len(set(moved)) == len(centres) and self.loss(moved, other) < loss - GAIN:
                    centres, width, loss = moved, other, self.loss(moved, other)
        return centres, width

    def rate(self, centres, width):
        belief = self._belief(centres, width)
        material, temperature = _losses(belief)
        return Filters(
            np.array(centres), np.full(len(centres), width), NETD_K / width,
            material + temperature, material,
            float(np.median(np.sqrt(belief.covariance[..., 0, 0]))),
        )  # fmt: skip

    def loss(self, centres, width):
        return sum(_losses(self._belief(centres, width)))

    def _best_place(self, others, width):
        """Where one more filter helps most, and the loss with it, infinite without a place."""
        belief = self._belief(others, width)
        end = self.high - width / 2 - STEP_UM / 2
        places = np.arange(self.low + width / 2, end, STEP_UM)
        places = [p for p in places.tolist() if not np.isclose(p, others, 0, STEP_UM / 2).any()]
        if not places:
            return None, np.inf
        losses = [sum(_losses(self._with(belief, p, width))) for p in places]
        best = int(np.argmin(losses))
        return places[best], losses[best]

    def _belief(self, centres, width):
        belief = self._nothing
        for centre in centres:
            belief = self._with(belief, centre, width)
        return belief

    def _with(self, belief, centre, width):
        """What one filter more tells: recursive least squares."""
        s, j = self._filter(centre, width)
        gain = np.einsum("dmij,dmj->dmi", belief.covariance, j)
        room = 1 + np.einsum("dmi,dmi->dm", j, gain)
        new = s[:, :, None] - s[:, None] - np.einsum("dnmi,dmi->dnm", belief.x, j)
        part = new / room[:, None]
        return _Belief(
            belief.apart + new * part,
            belief.x + part[..., None] * gain[:, None],
            belief.covariance - gain[..., None] * (gain / room[..., None])[..., None, :],
        )

    def _filter(self, centre, width):
        """Signal (D, m) and Jacobian (D, m, r) through a filter, in noise units."""
        key = (round(centre, 6), round(width, 6))
        if key not in self._seen:
            noise = width * noise_sigma(centre, NETD_K / width)
            self._seen[key] = tuple(
                (self._up_to(a, centre + width / 2) - self._up_to(a, centre - width / 2)) / noise
                for a in (self._signal, self._lean)
            )
        return self._seen[key]

    def _up_to(self, integral, wavelength_um):
        """An integral (D, m, edges, ...) up to a wavelength within the fine bands."""
        at = (wavelength_um - self.low) / STEP_UM
        i = int(np.clip(at, 0, integral.shape[2] - 2))
        return integral[:, :, i] + (at - i) * (integral[:, :, i + 1] - integral[:, :, i])


def _losses(belief):
    """The two parts of the loss, nats."""
    material = np.log(np.exp(-belief.apart / 8).sum(axis=2)).mean()
    temperature = np.log1p(belief.covariance[..., 0, 0] / TOLERANCE_K**2).mean() / 2
    return float(material), float(temperature)
