"""Draws from a Record: other bands, noise, environment and library, and the truth still the truth.

The Record is made by hand: grey materials under Eq. 1, band by band, so that a material is
known by how much it emits and Eq. 1 holds in bands of any width.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from traced import one_thread  # noqa: F401

import training.samples as samples
from physics.library import SKY
from physics.planck import noise_sigma, planck
from training.samples import MATERIALS, Sample, draw, expected_by
from training.scenes import Record

NAMES = ("a", "b", SKY, "c", "d", "e", "f", "g", "h", "i")
GREY = np.array([0.95, 0.88, 0.2, 0.8, 0.73, 0.65, 0.58, 0.5, 0.43, 0.35])
SIZE = 24
FINE = 8 + 0.06 * (np.arange(100) + 0.5)


def record(seed=0, materials=(0, 1, 3, 5), sky=True):
    rng = np.random.default_rng(seed)
    shape = (SIZE, SIZE)
    material = rng.choice(materials, (SIZE // 4, SIZE // 4)).repeat(4, 0).repeat(4, 1)
    view = rng.uniform(0, 1, shape)
    t = rng.uniform(280, 300, shape)
    w = FINE[:, None, None]
    above = np.clip(0.25 + np.abs(w - 10.8) / 3.5, 0, 1) * planck(w, 285.0)
    x = (view * above + (1 - view) * planck(w, 288.0)).astype(np.float16)
    if sky:
        material[:8], x[:, :8], view[:8], t[:8] = 2, 0, 1, 285
    e = np.broadcast_to(GREY[:, None], (10, 100)).astype(np.float32)
    s = GREY[material] * planck(w, t) + (1 - GREY[material]) * x.astype(float)
    s = np.where(material == 2, above, s)
    f = lambda a: a.astype(np.float32)
    return Record(f(s), x, f(t), f(view), material.astype(np.uint8), e, NAMES, FINE, 0)


RECORD = record()


def draws(n, of=RECORD):
    return [draw(of, np.random.default_rng([7, i])) for i in range(n)]


@pytest.fixture(scope="module")
def drawn():
    return draws(16)


def upright(sample):
    """A Sample as the scene stands, and whether it was drawn as its mirror image."""
    t = sample.temperature_k.numpy()
    row, column = np.argwhere(RECORD.temperature_k == t[-1, -1])[0]  # all differ, but the sky's
    mirrored = column == 0 or RECORD.temperature_k[row, column - 1] != t[-1, -2]
    if not mirrored:
        return sample, False
    turned = (a.flip(-1) for a in sample[1:-1])
    return Sample(sample.known, *turned, sample.glance), True


def level(sample):
    """Which of GREY each material of the library is, by its mean emissivity."""
    e = sample.known.emissivity.mean(dim=(1, 2)).numpy()
    return np.abs(e[:, None] - GREY).argmin(axis=1)


def flat(sample):
    return [*sample.known, *(x for x in sample if isinstance(x, torch.Tensor))]


def test_the_same_generator_draws_the_same_sample():
    a, b, c = (draw(RECORD, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert all(torch.equal(x, y) for x, y in zip(flat(a), flat(b), strict=True))
    assert a.known.sigma.shape != c.known.sigma.shape or not torch.equal(a.radiance, c.radiance)


def test_truth_follows_the_library_wherever_its_materials_stand(drawn):
    orders, mirrored = set(), set()
    for s in drawn:
        s, turned = upright(s)
        mirrored.add(turned)
        names = level(s)
        assert len(set(names)) == len(names) and MATERIALS <= len(names) <= len(NAMES)
        # what is at a pixel is what was there, under its new number
        np.testing.assert_array_equal(names[s.material.numpy()], RECORD.material)
        np.testing.assert_array_equal(s.known.is_sky.numpy(), names == 2)
        np.testing.assert_array_equal(s.ground.numpy(), RECORD.material != 2)
        np.testing.assert_array_equal(s.temperature_k.numpy(), RECORD.temperature_k)
        np.testing.assert_array_equal(s.sky_view.numpy(), RECORD.sky_view)
        orders.add(tuple(names))
    assert len(orders) == len(drawn) and mirrored == {False, True}
    assert len({names[0] for names in orders}) > 4 and len({len(n) for n in orders}) > 2


def test_the_sky_is_in_the_library_where_none_is_in_view():
    for s in draws(3, record(1, sky=False)):
        assert s.known.is_sky.sum() == 1 and s.ground.all()
        assert s.known.sky_mean.max() == 0 and s.known.sky_object.max() == 0


def test_bands_are_weights_over_8_to_14_um():
    kinds = set()
    for seed in range(300):
        weight, centre, width = samples._bands(FINE, np.random.default_rng(seed))
        n = len(centre)
        assert weight.shape == (n, 100) and 3 <= n <= 100 and (weight >= 0).all()
        np.testing.assert_allclose(weight.sum(axis=1), 1, rtol=1e-12)
        np.testing.assert_allclose(weight @ FINE, centre, rtol=1e-12)
        assert (np.diff(centre) > 0).all() and (width > 0.06 - 1e-9).all()
        seen = weight > 0
        low, high = FINE[seen.argmax(axis=1)] - 0.03, FINE[99 - seen[:, ::-1].argmax(axis=1)] + 0.03
        assert low.min() >= 8 - 1e-9 and high.max() <= 14 + 1e-9
        # a band is as wide as the light that it gathers, to the fine bands at its two ends
        assert (high - low > width - 1e-6).all() and (high - low < width + 0.12 + 1e-6).all()
        assert (np.abs(centre - (low + high) / 2) < 0.06).all()
        gaps = np.diff(centre)
        equidistant = gaps.max() - gaps.min() < 0.07
        kinds.add((equidistant, bool((gaps > 1.1 * width[1:]).all()), n < 10, n > 50))
    assert {k[0] for k in kinds} == {k[1] for k in kinds} == {True, False}
    assert {k[2] for k in kinds} == {k[3] for k in kinds} == {True, False}


def test_samples_hold_the_bands_noise_and_objects_they_should(drawn):
    netds, sizes, objects = [], set(), set()
    for s in drawn:
        w = s.known.nodes_um.mean(1).double().numpy()
        n = len(w)
        assert s.radiance.shape == s.texture.shape == (n, SIZE, SIZE) and (np.diff(w) > 0).all()
        netd = s.known.sigma.double().numpy() / noise_sigma(w, 1.0)
        np.testing.assert_allclose(netd, netd[0], rtol=1e-5)
        assert 0.01 <= netd[0] <= 0.2 and 1 <= len(s.known.environment) <= 8
        netds.append(netd[0])
        sizes.add(n)
        objects.add(len(s.known.environment))
        assert s.radiance.dtype == s.texture.dtype == torch.float32
        assert s.material.dtype == torch.int64 and s.ground.dtype == torch.bool
    assert max(netds) > 3 * min(netds) and len(sizes) > 8 and len(objects) > 4


def test_equation_1_holds_up_to_noise_of_the_size_that_is_claimed(monkeypatch):
    """Of ground pixels S - e B(T) - (1 - e) X is white, of zero mean and variance sigma^2."""
    monkeypatch.setattr(samples, "CURVE_ERROR", 0.0)
    for s in draws(8):
        s, _ = upright(s)
        known, ground = s.known, s.ground.numpy()
        e = GREY[RECORD.material][ground][:, None]
        nodes = known.nodes_um.double().numpy()
        t = RECORD.temperature_k[ground].astype(float)
        glow = planck(nodes, t[:, None, None]).mean(axis=-1)
        x = s.texture.double().numpy()[:, ground].T
        rest = s.radiance.double().numpy()[:, ground].T - e * glow - (1 - e) * x
        z, netd = rest / known.sigma.numpy(), known.sigma[0] / noise_sigma(nodes[0].mean(), 1)
        # a band of parts of fine ones is not quite a box: 0.1 of the noise at 10 mK and 100 bands
        bias, count = 0.1 * 0.01 / netd.item(), z.size
        assert abs(z.mean()) < 5 / np.sqrt(count) + bias
        assert abs((z**2).mean() - 1) < 5 * np.sqrt(2 / count) + bias**2
        pairs = (z[:, 1:] * z[:, :-1]).mean()
        assert abs(pairs) < 5 / np.sqrt(count) + bias**2


def test_the_library_errs_as_much_as_is_said(monkeypatch):
    monkeypatch.setattr(samples, "CURVE_ERROR", 0.0)
    exact = draws(8)
    monkeypatch.undo()
    for a, b in zip(exact, draws(8), strict=True):
        np.testing.assert_allclose(a.known.emissivity, GREY[level(a)][:, None, None]
                                   + np.zeros_like(a.known.emissivity), atol=1e-5)  # fmt: skip
        error = (a.known.emissivity - b.known.emissivity).abs()
        assert error.max() < 5 * samples.CURVE_ERROR
        assert error[b.known.is_sky > 0].max() < 1e-6
    errs = [(a.known.emissivity - b.known.emissivity).abs().max() > 1e-4
            for a, b in zip(exact, draws(8), strict=True)]  # fmt: skip
    assert any(errs) and not all(errs)


def test_a_crop_is_a_part_of_the_scene_that_is_known_as_a_whole():
    places = set()
    for seed in range(6):
        whole, _ = upright(draw(RECORD, np.random.default_rng(seed)))
        part, _ = upright(draw(RECORD, np.random.default_rng(seed), side=10))
        assert all(torch.equal(a, b) for a, b in zip(whole.known, part.known, strict=True))
        t = part.temperature_k.numpy()
        y, x = np.argwhere(RECORD.temperature_k == t[0, 0])[0]  # all of them differ, but the sky's
        if part.ground[0, 0]:
            places.add((y, x))
            for a, b in zip(whole[1:-1], part[1:-1], strict=True):
                assert torch.equal(a[..., y : y + 10, x : x + 10], b)
        assert part.radiance.shape[1:] == part.material.shape == part.ground.shape == (10, 10)
    assert len(places) > 1


def test_a_glance_lies_where_the_sample_lies(monkeypatch):
    """Seen by one who calls bright the first material and dark the second."""
    t = 280 + np.add(*np.indices((SIZE, SIZE))) / 2.0  # K
    slope = replace(RECORD, radiance=planck(FINE[:, None, None], t).astype(np.float32))
    seen, steps, without = {}, set(), 0

    def by_brightness(network):
        def look(scene, radiance):
            bright = radiance.mean(0) > radiance.mean()
            p = torch.zeros(len(scene["is_sky"]), *bright.shape)
            p[0], p[1] = bright, ~bright
            return SimpleNamespace(material_probability=p)

        return look

    monkeypatch.setattr(samples, "TeXModel", by_brightness)
    for seed in range(8):  # some of them are turned
        assert len(expected_by(None, draw(slope, np.random.default_rng(seed), side=1))) > 1
    for seed in range(40):
        sample = draw(slope, np.random.default_rng([3, seed]), side=14)
        nats = expected_by(None, sample).reshape(-1, 14, 14)
        assert nats.shape[0] == len(sample.known.is_sky)
        if sample.glance is None:
            without += 1
            assert (nats == 0).all()
            continue
        bright = sample.radiance.mean(0) > sample.glance.radiance.mean()
        agrees = [(bright == (n[0] > n[1])).float().mean() for n in (nats, nats.flip(-1))]
        steps.add(sample.glance.step)
        seen.setdefault(sample.glance.turned, []).append(agrees)
    assert set(seen) == {False, True} and steps == {2, 3, 4}
    for as_it_is, mirrored in (np.mean(agrees, axis=0) for agrees in seen.values()):
        assert as_it_is > 0.9 > 0.8 > mirrored
    assert 10 < without < 30
    assert all(draw(RECORD, np.random.default_rng(seed)).glance for seed in range(3))


def test_a_scene_of_every_material_and_one_of_few_records():
    """Nothing else to add to the library, in either case."""
    (s,) = draws(1, record(2, materials=tuple(range(10))))
    assert len(s.known.is_sky) == 10
    few = record(3, materials=(0, 1))
    small = Record(few.radiance, few.texture, few.temperature_k, few.sky_view,
                   few.material, few.curves[:3], NAMES[:3], FINE, 0)  # fmt: skip
    (s,) = draws(1, small)
    assert len(s.known.is_sky) == 3


def test_a_draw_leaves_its_record_alone():
    before = RECORD.radiance.copy(), RECORD.temperature_k.copy()
    s = draw(RECORD, np.random.default_rng(0))
    s.radiance.zero_()
    np.testing.assert_array_equal(RECORD.radiance, before[0])
    np.testing.assert_array_equal(RECORD.temperature_k, before[1])


def test_scene_and_glance_know_how_much_of_the_light_is_the_sky_s(monkeypatch):
    before = draws(8)

    def half(environment, cube, library):
        k = len(environment)
        usual = np.append(np.full(k - 1, 0.5 / max(k - 1, 1)), 0.5 if k > 1 else 1)
        return replace(environment, usual_lighting=usual)

    monkeypatch.setattr(samples, "with_usual_lighting", half)
    for was, s in zip(before, draws(8), strict=True):
        if len(s.known.environment) > 1:
            assert s.known.usual_lighting[-1] == 0.5
            if s.glance is not None:
                pairs = zip(was.glance.scene.values(), s.glance.scene.values(), strict=True)
                assert any(a.shape == b.shape and (a != b).any() for a, b in pairs)
