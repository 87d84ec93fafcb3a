"""The curriculum: who goes up, who goes down, who stays."""

from __future__ import annotations

import pytest
import torch
from locorl.terrain.curriculum import Curriculum, CurriculumConfig
from locorl.terrain.map import TerrainConfig, TerrainMap
from locorl.terrain.tile import PARKOUR

LEVELS = 5


@pytest.fixture(scope="module")
def terrain() -> TerrainMap:
    return TerrainMap(TerrainConfig(kinds=("platforms",), levels=LEVELS, columns=3, tile=PARKOUR))


def curriculum(terrain: TerrainMap, n: int, seed: int = 0, hip_height=None, **changes) -> Curriculum:
    generator = torch.Generator().manual_seed(seed)
    return Curriculum(CurriculumConfig(**changes), terrain, n, generator, hip_height)


def ended(course: Curriculum, level: int, distance: float, commanded: float = 10.0, **more) -> list[int]:
    """Levels after an episode of every robot on `level`."""
    everyone = torch.arange(len(course.level))
    course.place(everyone)
    course.level[:] = level
    n = len(everyone)
    course.update(everyone, torch.full((n,), distance), torch.full((n,), commanded), **more)
    return course.level.tolist()


def test_robots_rise_fall_and_stay_by_the_share_of_the_distance(terrain):
    course = curriculum(terrain, 4)
    assert ended(course, 2, 8.1) == [3] * 4
    assert ended(course, 2, 7.9) == [2] * 4
    assert ended(course, 2, 4.1) == [2] * 4
    assert ended(course, 2, 3.9) == [1] * 4
    assert ended(course, 0, 0.0) == [0] * 4


def test_the_first_reset_leaves_everyone_where_they_are(terrain):
    course = curriculum(terrain, 50)
    before = course.level.clone()
    some = torch.arange(0, 50, 2)
    for _ in range(3):
        course.update(some, torch.zeros(25), torch.full((25,), 10.0))
        course.update(some, torch.full((25,), 20.0), torch.full((25,), 10.0))
    assert torch.equal(course.level, before)
    course.place(some)
    course.update(torch.arange(50), torch.full((50,), 9.0), torch.full((50,), 10.0))
    assert torch.equal(course.level[1::2], before[1::2])
    assert (course.level[::2] != before[::2]).any()


def test_only_the_named_robots_move(terrain):
    course = curriculum(terrain, 10)
    course.place(torch.arange(10))
    course.level[:] = 2
    course.update(torch.tensor([7, 3]), torch.tensor([9.0, 1.0]), torch.tensor([10.0, 10.0]))
    assert course.level.tolist() == [2, 2, 2, 1, 2, 2, 2, 3, 2, 2]


def test_past_the_top_a_robot_goes_to_any_level(terrain):
    course = curriculum(terrain, 3000)
    counts = torch.bincount(torch.tensor(ended(course, LEVELS - 1, 9.0)), minlength=LEVELS)
    assert len(counts) == LEVELS
    assert ((counts - 600).abs() < 120).all()  # 5 standard deviations


def test_success_counts_without_distance_and_standing_robots_stay(terrain):
    course = curriculum(terrain, 2)
    assert ended(course, 1, 0.0, success=torch.tensor([True, False])) == [2, 0]
    assert ended(course, 2, 5.0, commanded=0.5) == [2, 2]
    assert ended(course, 2, 0.0, commanded=0.5) == [2, 2]


def test_levels_start_low_and_columns_are_dealt_evenly(terrain):
    course = curriculum(terrain, 301, start_level=2)
    assert set(course.level.tolist()) == {0, 1, 2}
    counts = torch.bincount(course.column)
    assert counts.max() - counts.min() <= 1
    assert course.column.tolist() != sorted(course.column.tolist())


def test_robots_are_placed_on_their_tiles(terrain):
    course = curriculum(terrain, 20)
    ids = torch.tensor([5, 2, 19])
    expected = [terrain.origins[course.level[i], course.column[i]].tolist() for i in ids]
    assert course.place(ids).tolist() == expected
    assert course.place(ids).shape == (3, 3)


def test_obstacles_are_capped_by_hip_height(terrain):
    # platforms of 0.1, 0.1875, 0.275, 0.3625, 0.45 m against 1.2 hip heights
    hips = torch.tensor([0.05, 0.16, 0.25, 0.30, 0.40]).repeat_interleave(40)
    allowed = torch.tensor([0, 1, 2, 2, 4]).repeat_interleave(40)
    course = curriculum(terrain, 200, hip_height=hips, hip_limit=1.2)
    everyone, seen = torch.arange(200), torch.zeros(200, dtype=torch.long)
    assert (course.level <= allowed).all()
    for _ in range(12):
        course.place(everyone)
        course.update(everyone, torch.full((200,), 10.0), torch.full((200,), 10.0))
        assert (course.level <= allowed).all()
        seen = torch.maximum(seen, course.level)
    assert torch.equal(seen, allowed)
    course.set_hip_heights(torch.full((200,), 0.16))
    assert course.level.max() == 1


def test_a_cap_without_hip_heights_is_refused(terrain):
    with pytest.raises(ValueError, match="hip height of each body"):
        curriculum(terrain, 4, hip_limit=1.0)


def test_a_saved_curriculum_goes_on_as_before(terrain):
    generator = torch.Generator().manual_seed(3)
    course = Curriculum(CurriculumConfig(), terrain, 64, generator)
    everyone = torch.arange(64)
    course.place(everyone[:40])
    state, random = course.state_dict(), generator.get_state()

    def go_on(subject: Curriculum) -> list[int]:
        for _ in range(6):
            subject.update(everyone, torch.linspace(0, 12, 64), torch.full((64,), 10.0))
        return subject.level.tolist()

    expected = go_on(course)
    other = torch.Generator().manual_seed(9)
    restored = Curriculum(CurriculumConfig(), terrain, 64, other)
    restored.load_state_dict(state)
    other.set_state(random)
    assert go_on(restored) == expected
    assert torch.equal(restored.column, course.column)


def test_a_state_of_another_run_is_refused(terrain):
    course = curriculum(terrain, 8)
    with pytest.raises(ValueError, match="8 robots loaded into one of 9"):
        curriculum(terrain, 9).load_state_dict(course.state_dict())
    course.level[:] = 4
    small = TerrainMap(TerrainConfig(kinds=("platforms",), levels=2, columns=3, tile=PARKOUR))
    with pytest.raises(ValueError, match="larger than 2 x 3"):
        curriculum(small, 8).load_state_dict(course.state_dict())


def test_equal_seeds_deal_equal_tiles(terrain):
    one, two, other = (curriculum(terrain, 100, seed=seed) for seed in (1, 1, 2))
    assert torch.equal(one.level, two.level)
    assert torch.equal(one.column, two.column)
    assert not torch.equal(one.level, other.level)


@pytest.mark.parametrize("changes", [{"demote": 0.9}, {"start_level": -1}, {"hip_limit": 0.0}])
def test_contradictory_thresholds_are_refused(changes):
    with pytest.raises(ValueError, match="CurriculumConfig"):
        CurriculumConfig(**changes)
