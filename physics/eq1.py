"""Eq. 1, the renderer that everything else inverts.

    S = e B(T) + (1 - e) X            heat signal
    X = V_1 S_1 + ... + V_k S_k       texture, of k environment objects

These are the paper's Eq. 1 and 2 and, with k few, its Eq. 4 and 5; here all are Eq. 1. Of its other
equations

    Eq. 3    B is Planck's law                                    `planck`
    Eq. 6    {T, m, V} = argmin |S~ - S|, S~ by Eq. 1             `exact`, `refinement`
    Eq. 7    dS = dT e B' + de (B - X) + dX (1 - e)               `contrast`

Arrays here are band-last, so that leading dimensions (pixels, or height and width)
broadcast. Numpy in, numpy out; torch in, torch out and differentiable in all of
T, e, V and the environment.
"""

from .planck import planck


def heat_signal(temperature_k, emissivity, texture, wavelength_um):
    """S (..., bands), W m-2 sr-1 um-1, of T, e and X.

    temperature_k  (...)         K
    emissivity     (..., bands)  0..1; soft material weights w (..., materials) enter
                                 as ``w @ library_emissivity``; at nodes (..., bands, n)
    texture        (..., bands)  X, W m-2 sr-1 um-1
    wavelength_um  (bands,)      um, of narrow bands; or (bands, n) nodes over which S of a wide
                                 band is averaged, as `bands.quadrature` makes them
    """
    if wavelength_um.ndim == 1:
        wavelength_um, emissivity = wavelength_um[:, None], emissivity[..., None]
    return _over_bands(temperature_k, emissivity, texture[..., None], wavelength_um)


def _over_bands(temperature_k, emissivity, texture, nodes_um):
    b = planck(nodes_um, temperature_k[..., None, None])
    return (emissivity * b + (1 - emissivity) * texture).mean(-1)


def render(temperature_k, emissivity, thermal_lighting, environment, wavelength_um):
    """S and X, each (..., bands), of T, e, V and the environment.

    thermal_lighting  (..., k)    V >= 0, summing to 1
    environment       (k, bands)  S_1..S_k, W m-2 sr-1 um-1; or at nodes (k, bands, n)

    The rest is as in `heat_signal`.
    """
    k, *of_band = environment.shape
    texture = thermal_lighting @ environment.reshape(k, -1)
    texture = texture.reshape(*texture.shape[:-1], *of_band)
    if len(of_band) == 1:
        return heat_signal(temperature_k, emissivity, texture, wavelength_um), texture
    return _over_bands(temperature_k, emissivity, texture, wavelength_um), texture.mean(-1)


def physics_loss(
    measured, temperature_k, emissivity, thermal_lighting, environment, wavelength_um, sigma
):
    """Squared residual of Eq. 1 in noise units, mean over bands: (...), 1 where only noise is left.

    measured is (..., bands), its noise sigma (bands,); the rest is as in `render`.
    """
    rendered, _ = render(temperature_k, emissivity, thermal_lighting, environment, wavelength_um)
    return (((rendered - measured) / sigma) ** 2).mean(-1)
