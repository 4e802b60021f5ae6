"""Paths become radiance in every band at once.

The main idea is to write Eq. 1 as what it changes on a surface's own glow,

    S = B + (1 - e) (X - B),

and to unroll it along a path of surfaces 0, 1, 2, ... that ends in the sky or by
roulette. With B_d = B(T_d), or the sky's radiance where the path leaves,

    S = B_0 + sum_{d >= 1} (prod_{i < d} (1 - e_i) / q_i) (B_d - B_{d-1}),     q_0 = 1
    X = B_1 + sum_{d >= 2} (prod_{1 <= i < d} (1 - e_i) / q_i) (B_d - B_{d-1})

is unbiased for any roulette q_i > 0, and S = B_0 + (1 - e_0) (X - B_0) on every path.
Only differences are scattered: in an isothermal enclosure each path gives B(T) exactly,
whatever e, and outdoors the noise is that of the contrast instead of that of the glow.
With every emitter but the sky switched off, the same path gives
X_sky = (prod_{1 <= i < d} (1 - e_i) / q_i) B_d if it leaves for the sky, else 0.

Planck's law and the sky are read from tables, linear in between; of the noise of a 50 mK
camera this costs under 1e-4 (Planck, 8-14 um) and 0.02 (sky, at the horizon).
"""

from dataclasses import dataclass

import numpy as np

from ..machinery.compiled import compiled
from ..planck import planck
from .trace import ESCAPED

TEMPERATURE_STEP_K = 1 / 32
SKY_ROWS = 513


@dataclass(frozen=True, eq=False)
class Shader:
    """Tables over the n cells of bands that paths are shaded in (`sensor`), float32.

    glow         (temperatures, n) B(T) from coldest_k in steps of TEMPERATURE_STEP_K
    coldest_k    K
    reflectance  (materials, n) 1 - e
    weight       (materials, n) (1 - e) / q
    kind         (materials,) what the result calls each material: several materials of the
                 paths may stand for one of the library that shades them
    sky          (SKY_ROWS, n) radiance; row i is at cos(zenith) = (i / (SKY_ROWS - 1))**2,
                 which is dense near the horizon; (1, n) zeros if there is no sky
    """

    glow: np.ndarray
    coldest_k: float
    reflectance: np.ndarray
    weight: np.ndarray
    kind: np.ndarray
    sky: np.ndarray

    @staticmethod
    def build(bands, emissivity, q, temperature_range_k, sky, kind=None):
        """Tables for Bands.

        emissivity (materials, n) of their cells; q (materials,) roulette; temperature_range_k
        (low, high); sky (wavelength_um, cos_zenith) -> (directions, n) radiance, or None; kind
        (materials,), each its own if None.
        """
        low, high = temperature_range_k
        coldest = np.floor(low)
        steps = int(np.ceil((high - coldest) / TEMPERATURE_STEP_K)) + 2
        t = coldest + TEMPERATURE_STEP_K * np.arange(steps)
        if sky is None:
            rows = np.zeros((1, len(bands.fine_um)))
        else:
            mu = np.linspace(0, 1, SKY_ROWS) ** 2
            rows = bands.in_cells(lambda w: sky(w, mu))
        glow = bands.in_cells(lambda w: planck(w, t[:, None]))
        return Shader(
            glow.astype(np.float32), float(coldest),
            (1 - emissivity).astype(np.float32),
            ((1 - emissivity) / q[:, None]).astype(np.float32),
            np.arange(len(q)) if kind is None else kind, rows.astype(np.float32),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ShadedPixels:
    """What a block of pixels is worth; means over a pixel's samples.

    radiance       (pixels, n) S over all samples; the rest is over the samples whose first
                   surface is of the pixel's majority kind (the lowest index if tied)
    material       (pixels,) uint16 kind of the majority material, or ESCAPED
    temperature_k  (pixels,) NaN for ESCAPED
    texture        (pixels, n) X; where the material is ESCAPED, the radiance of the sky
    sky_texture    (pixels, n) X with every emitter but the sky switched off; likewise
    sky_view       (pixels,) fraction of first bounces that leave for the sky; 1 for ESCAPED
    """

    radiance: np.ndarray
    material: np.ndarray
    temperature_k: np.ndarray
    texture: np.ndarray
    sky_texture: np.ndarray
    sky_view: np.ndarray


def shade(paths, shader, spp):
    """Paths, spp per pixel -> ShadedPixels."""
    first = paths.material[paths.start[:-1]]
    sky = first == ESCAPED
    kind = np.where(sky, ESCAPED, shader.kind[np.where(sky, 0, first)]).reshape(-1, spp)
    material = _majority(kind, shader.kind.max() + 1)
    n = shader.glow.shape[1]
    sums = [np.zeros((len(material), n)) for _ in range(3)]
    scalars = _shade(
        paths.start, paths.end, paths.material, paths.value, kind == material[:, None], shader.glow,
        np.float32(shader.coldest_k), shader.reflectance, shader.weight, shader.sky, *sums,
    )  # fmt: skip
    count, temperature, sky_view = scalars
    counted = count[:, None]
    return ShadedPixels(
        sums[0] / spp, material, temperature / count, sums[1] / counted, sums[2] / counted,
        sky_view / count,
    )  # fmt: skip


@compiled(nogil=True)
def _majority(first, kinds):
    """(pixels,) most frequent kind among the first surfaces (pixels, spp)."""
    majority = np.empty(len(first), np.uint16)
    for p in range(len(first)):
        count = np.zeros(kinds + 1, np.int64)  # the last one counts ESCAPED
        for m in first[p]:
            count[min(m, kinds)] += 1
        best = np.argmax(count)
        majority[p] = best if best < kinds else ESCAPED
    return majority


@compiled(nogil=True)
def _read(material, value, glow, coldest, sky, out):
    """Fill out (n,) with B_d of one path vertex."""
    if material == ESCAPED:
        x = np.sqrt(min(max(value, np.float32(0)), np.float32(1))) * np.float32(len(sky) - 1)
        table = sky
    else:
        x = (value - coldest) * np.float32(1 / TEMPERATURE_STEP_K)
        table = glow
    i = min(int(x), len(table) - 2)
    f = np.float32(x - i)
    a, b = table[i], table[i + 1]
    for j in range(len(out)):
        out[j] = a[j] + f * (b[j] - a[j])


@compiled(nogil=True)
def _shade(
    start, ends, material, value, chosen, glow, coldest, reflectance, weight, sky,
    sum_s, sum_x, sum_sky,
):  # fmt: skip
    """Add every path's S, X and X_sky to the sums (pixels, n) of its pixel.

    S of all samples, the rest of the chosen (pixels, spp). Returns count, temperature and
    sky-view sums (pixels,) of the chosen.
    """
    (pixels, spp), n = chosen.shape, sum_s.shape[1]
    count, temperature, sky_view = np.zeros(pixels), np.zeros(pixels), np.zeros(pixels)
    first, here, before = np.empty((3, n), np.float32)
    x, w = np.empty((2, n), np.float32)
    for p in range(pixels):
        s, t_x, t_sky = sum_s[p], sum_x[p], sum_sky[p]
        for sample in range(spp):
            path, counts = p * spp + sample, chosen[p, sample]
            a, end = start[path], ends[path]
            _read(material[a], value[a], glow, coldest, sky, first)
            if material[a] == ESCAPED:
                for j in range(n):
                    s[j] += first[j]
                if counts:
                    count[p] += 1
                    temperature[p] = np.nan
                    sky_view[p] += 1
                    for j in range(n):
                        t_x[j] += first[j]
                        t_sky[j] += first[j]
                continue

            # X along the path; `w` is the product of (1 - e) / q behind surface 0.
            if end == a + 1:  # slipped out of a closed scene: as if it met its own kind
                x[:] = first
            else:
                _read(material[a + 1], value[a + 1], glow, coldest, sky, x)
            if end > a + 2:
                before[:] = x
                w[:] = 1
                for d in range(a + 2, end):
                    r = weight[material[d - 1]]
                    _read(material[d], value[d], glow, coldest, sky, here)
                    for j in range(n):
                        w[j] *= r[j]
                        x[j] += w[j] * (here[j] - before[j])
                        before[j] = here[j]

            r = reflectance[material[a]]
            for j in range(n):
                s[j] += first[j] + r[j] * (x[j] - first[j])
            if counts:
                count[p] += 1
                temperature[p] += value[a]
                for j in range(n):
                    t_x[j] += x[j]
                if end > a + 1 and material[end - 1] == ESCAPED:
                    if end == a + 2:
                        sky_view[p] += 1
                        for j in range(n):
                            t_sky[j] += x[j]
                    else:
                        for j in range(n):
                            t_sky[j] += w[j] * before[j]
    return count, temperature, sky_view
