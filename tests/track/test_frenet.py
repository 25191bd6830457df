"""Projection: exact where it is unique, continuous through hairpins, and never across an infield."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from racerl.track.frenet import FrenetFrame, wrap_angle
from racerl.track.load import read_track
from racerl.track.track import build_track
from tests.conftest import CONF

TRACK = read_track(CONF / "track" / "l_shape.csv")
FRAME = FrenetFrame(TRACK, dtype=torch.float64)
HAIRPIN = float(np.argmax(-TRACK.curvature) * TRACK.spacing)
share = st.floats(0.0, 1.0)


def column(*values):
    return torch.tensor(values, dtype=torch.float64)


def nearest_distance(x, y):
    """Brute force: the distance to a centreline sampled every 2 mm."""
    s = torch.arange(0, TRACK.length, 0.002, dtype=torch.float64)
    px, py, _ = FRAME.position(s, torch.zeros_like(s))
    return torch.hypot(x[:, None] - px, y[:, None] - py).min(dim=1).values


@settings(max_examples=300)
@given(share, st.floats(-0.45, 0.45), st.floats(-0.35, 0.35))
def test_projection_inverts_position(place, n, moved):
    s = column(place * TRACK.length)
    kappa = FRAME.lookup(s, FRAME.curvature)[0]
    if float(1 - kappa * n) < 0.1:
        return
    x, y, yaw = FRAME.position(s, column(n))
    foot = FRAME.project(x, y, FRAME.wrap(s + moved))
    assert abs(float(FRAME.difference(foot.s, s))) < 1e-3
    assert abs(float(foot.n) - n) < 1e-4
    assert abs(float(foot.yaw - yaw)) < 3e-3


@settings(max_examples=300)
@given(st.floats(-2.0, 2.0), st.floats(-0.55, -0.40), st.floats(-0.35, 0.35))
def test_the_hairpin_projects_to_the_nearest_point(away, n, moved):
    """Where 1 − κn vanishes, s is ambiguous but the distance is not."""
    s = FRAME.wrap(column(HAIRPIN + away))
    x, y, _ = FRAME.position(s, column(n))
    foot = FRAME.project(x, y, FRAME.wrap(s + moved))
    nearest = float(nearest_distance(x, y))
    assert abs(float(foot.n)) <= nearest * 1.025 + 1e-3
    assert abs(float(foot.n)) >= nearest - 1e-3
    fx, fy, _ = FRAME.position(foot.s, foot.n)
    assert float(torch.hypot(fx - x, fy - y)) < 0.03


@pytest.mark.parametrize("n", [-0.40, -0.46, -0.48, -0.49, -0.50, 0.3])
def test_a_walk_through_the_hairpin_arrives(n):
    """Along an offset line the walk gains the whole hairpin, whatever happens at the centre of curvature."""
    s = torch.linspace(HAIRPIN - 2.5, HAIRPIN + 2.5, 300, dtype=torch.float64)
    x, y, _ = FRAME.position(FRAME.wrap(s), torch.full_like(s, n))
    last, travelled, furthest = FRAME.wrap(s[:1]), 0.0, 0.0
    for i in range(len(s)):
        foot = FRAME.project(x[i : i + 1], y[i : i + 1], last)
        travelled += float(FRAME.difference(foot.s, last))
        furthest = max(furthest, float(foot.n.abs()))
        last = foot.s
    assert travelled == pytest.approx(5.0, abs=0.02)
    assert furthest <= abs(n) + 1e-3


def test_a_car_does_not_jump_across_the_infield():
    """Two straights 0.9 m apart: crossing to the other one counts as leaving the own one."""
    straight = np.arange(0, 10, 0.1)
    turn = np.linspace(-np.pi / 2, np.pi / 2, 16)[1:-1]
    points = np.concatenate(
        [
            np.stack([straight, 0 * straight], axis=1),
            np.stack([10 + 0.45 * np.cos(turn), 0.45 + 0.45 * np.sin(turn)], axis=1),
            np.stack([straight[::-1], 0 * straight + 0.9], axis=1),
            np.stack([-0.1 - 0.45 * np.cos(turn), 0.45 - 0.45 * np.sin(turn)], axis=1),
        ]
    )
    width = np.full(len(points), 0.44)
    frame = FrenetFrame(build_track("oval", points, width, width), dtype=torch.float64)
    s = column(6.0)
    for n in np.arange(0.0, 0.95, 0.02):
        foot = frame.project(column(6.0), column(float(n)), s)
        s = foot.s
        assert float(foot.s) == pytest.approx(6.0, abs=0.02) and float(foot.n) == pytest.approx(n, abs=2e-3)
    assert float(foot.n) > 0.44 + 0.4  # far beyond its own boundary, although on the other straight


def test_a_crossing_track_keeps_its_branch():
    angle = np.arange(400) / 400 * 2 * np.pi
    points = np.stack([8 * np.sin(angle), 4 * np.sin(2 * angle)], axis=1)
    width = np.full(400, 0.5)
    track = build_track("eight", points, width, width)
    frame = FrenetFrame(track, dtype=torch.float64)
    s = torch.linspace(0.1, track.length - 0.1, 500, dtype=torch.float64)
    x, y, _ = frame.position(s, torch.full_like(s, 0.2))
    last = s[:1]
    for i in range(500):
        foot = frame.project(x[i : i + 1], y[i : i + 1], last)
        last = foot.s
        assert float(frame.difference(foot.s, s[i])) == pytest.approx(0.0, abs=1e-3)


@settings(max_examples=200)
@given(share, share)
def test_differences_are_short_and_signed(a, b):
    s, t = column(a * TRACK.length), column(b * TRACK.length)
    difference = float(FRAME.difference(s, t))
    assert -TRACK.length / 2 - 1e-9 <= difference <= TRACK.length / 2 + 1e-9
    assert float(FRAME.difference(FRAME.wrap(t + difference), s)) == pytest.approx(0.0, abs=1e-9)


@settings(max_examples=200)
@given(st.floats(-100, 100))
def test_wrap_and_lookup_are_periodic(s):
    wrapped = FRAME.wrap(column(s))
    assert 0.0 <= float(wrapped) < TRACK.length
    again = FRAME.lookup(column(s + TRACK.length), FRAME.curvature)[0]
    assert float(FRAME.lookup(column(s), FRAME.curvature)[0]) == pytest.approx(float(again), abs=1e-9)


def test_a_batch_is_its_cars(l_count=64):
    draw = np.random.default_rng(0)
    s = torch.tensor(draw.uniform(0, TRACK.length, l_count))
    x, y, _ = FRAME.position(s, torch.tensor(draw.uniform(-0.6, 0.6, l_count)))
    start = FRAME.wrap(s + torch.tensor(draw.uniform(-0.3, 0.3, l_count)))
    together = FRAME.project(x, y, start)
    for i in range(l_count):
        alone = FRAME.project(x[i : i + 1], y[i : i + 1], start[i : i + 1])
        assert torch.equal(together.s[i], alone.s[0]) and torch.equal(together.n[i], alone.n[0])


def test_single_precision_is_precise_enough():
    single = FrenetFrame(TRACK)
    draw = np.random.default_rng(1)
    s, n = torch.tensor(draw.uniform(0, TRACK.length, 2000)), torch.tensor(draw.uniform(-0.4, 0.4, 2000))
    x, y, _ = FRAME.position(s, n)
    foot = single.project(x.float(), y.float(), s.float())
    assert (foot.n - n).abs().max() < 1e-4 and FRAME.difference(foot.s.double(), s).abs().max() < 1e-3


def test_the_compiled_walk_follows_the_tensors():
    """In single precision on the CPU the walk and the look-ups are C; a car at a boundary and in the hairpin too."""
    single, exact = FrenetFrame(TRACK), FrenetFrame(TRACK, dtype=torch.float64)
    assert single._kernel is not None and exact._kernel is None
    generator = torch.Generator().manual_seed(0)
    s, moved = torch.rand(2, 20_000, generator=generator, dtype=torch.float64)
    s, moved = s * TRACK.length, 0.6 * (moved - 0.5)
    n = 1.2 * (torch.rand(20_000, generator=generator, dtype=torch.float64) - 0.5)
    x, y, _ = exact.position(s, n)
    last = exact.wrap(s + moved)
    got, expected = single.project(x.float(), y.float(), last.float()), exact.project(x, y, last)
    apart = exact.difference(got.s.double(), expected.s).abs()
    # where two cells are equally near, single precision may take the other one: a cell apart, the same point in space
    assert (apart < 2e-4).double().mean() > 0.99 and apart.max() < 0.2
    assert (got.n - expected.n).abs().quantile(0.99) < 1e-5 and (got.n - expected.n).abs().max() < 0.02
    for table in ("curvature", "width_left", "half_width"):
        for shift in (0.0, -3 * TRACK.length, 5 * TRACK.length):
            single_table, exact_table = getattr(single, table), getattr(exact, table)
            apart = single.lookup((s + shift).float(), single_table)[0] - exact.lookup(s + shift, exact_table)[0]
            assert apart.abs().max() < 2e-3 * (1 + exact_table.abs().max())
    assert torch.isfinite(single.lookup(torch.tensor([0.0, TRACK.length, -1e-9]), single.curvature)[0]).all()


def test_a_projection_takes_other_precisions_and_keeps_the_slope_of_one_coordinate():
    single = FrenetFrame(TRACK)
    s = torch.linspace(0.5, TRACK.length - 0.5, 50)
    x, y, yaw = single.position(s, torch.full_like(s, 0.1))
    expected = single.project(x, y, s)
    for precise in (single.project(x.double(), y.double(), s.double()), single.project(x, y.double(), s)):
        assert all(map(torch.equal, precise, expected))
    aside = y.clone().requires_grad_()
    slope = torch.autograd.grad(single.project(x, aside, s).n.sum(), aside)[0]
    assert torch.allclose(slope, torch.cos(yaw), atol=1e-2)


@pytest.mark.parametrize("device_type", ["compiled", "torch"])
def test_places_are_projections_with_the_boundaries_at_hand(device_type):
    """Rows of a place against the projection, the tables and the wrapped difference, on C and on tensors."""
    track = TRACK
    frame = FrenetFrame(track, dtype=torch.float32 if device_type == "compiled" else torch.float64)
    generator = torch.Generator().manual_seed(5)
    s = torch.rand(500, generator=generator) * track.length
    n = (torch.rand(500, generator=generator) - 0.5) * 0.9
    x, y, yaw = frame.position(s.to(frame.x.dtype), n.to(frame.x.dtype))
    last = frame.wrap(s - 0.2).to(frame.x.dtype)
    place, way = frame.locate(x, y, yaw + 0.3, last)
    foot = frame.project(x, y, last)
    assert torch.allclose(place[0], foot.s) and torch.allclose(place[1], foot.n)
    assert torch.allclose(place[2], wrap_angle(yaw + 0.3 - foot.yaw), atol=1e-5)
    middle, half_width = frame.lookup(foot.s, frame.middle, frame.half_width)
    assert torch.allclose(place[3], foot.n - middle, atol=1e-6)
    assert torch.allclose(place[4], half_width - (foot.n - middle).abs(), atol=1e-6)
    assert torch.allclose(way, frame.difference(foot.s, last), atol=1e-5)


def test_slopes_of_places_and_lookups_in_c_are_those_of_the_tensors():
    """At boundaries that open and close, beside the centre of the hairpin, at the seam; the tensors' are autograd's."""
    wave = 0.1 * np.sin(np.arange(len(TRACK.x)) * TRACK.spacing)
    track = replace(TRACK, width_left=TRACK.width_left + wave, width_right=TRACK.width_right + wave**2)
    compiled, tensors = FrenetFrame(track), FrenetFrame(track)
    tensors._kernel = None
    generator = torch.Generator().manual_seed(0)
    s, moved, n, turn = torch.rand(4, 40_000, generator=generator)
    s[:1000] *= 2 * track.spacing / track.length  # beside the seam
    x, y, yaw = compiled.position(s * track.length, 1.6 * (n - 0.5))
    given = x, y, yaw + 2 * (turn - 0.5), compiled.wrap(s * track.length + 0.6 * (moved - 0.5))
    weights = torch.randn(6, 40_000, generator=generator)

    def of_places(frame):
        inputs = [each.clone().requires_grad_() for each in given]
        place, way = frame.locate(*inputs)
        return torch.stack(torch.autograd.grad((torch.cat([place, way[None]]) * weights).sum(), inputs)), place.detach()

    (got, place), (expected, _) = of_places(compiled), of_places(tensors)
    apart = (got - expected).norm(dim=0) / expected.norm(dim=0)
    stretch = 1 - compiled.lookup(place[0], compiled.curvature)[0] * place[1]
    assert (apart > 1e-3).sum() <= 4  # where two cells are equally near, the tensors may take the other one
    for some in (stretch < 0.1, place[0] < track.spacing):
        assert some.sum() > 50 and apart[some].quantile(0.95) < 1e-4
    for laps in (-3, 0, 1):
        slopes = []
        for frame in (compiled, tensors):
            at = ((s + laps) * track.length).requires_grad_()
            found = torch.stack(frame.lookup(at, frame.curvature, frame.half_width))
            slopes.append(torch.autograd.grad((found * weights[:2]).sum(), at)[0])
        assert ((slopes[0] - slopes[1]).abs() > 1e-3 * slopes[1].abs().max()).sum() <= 4  # in the cell beside, at most


def test_a_slope_outlives_the_tables_that_it_was_looked_up_in():
    """C is told where they are, not what they hold."""
    frame = FrenetFrame(TRACK)
    s = torch.linspace(0.0, TRACK.length, 1000).requires_grad_()
    expected = torch.autograd.grad(frame.lookup(s, frame.curvature)[0].sum(), s)[0]
    made = 0.5 * frame.lookup(s, 2 * frame.curvature)[0].sum()
    others = [torch.full_like(frame.curvature, 1e9) for _ in range(100)]
    assert torch.equal(torch.autograd.grad(made, s)[0], expected) and len(others) == 100
