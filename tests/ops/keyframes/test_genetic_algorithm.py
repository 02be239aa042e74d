"""The genetic algorithm: its operators one by one, and what a run promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.keyframes import genetic_algorithm as genetics
from kinedex.ops.keyframes.consensus import Consensus, find_consensus
from kinedex.ops.keyframes.fitness import fitness_of, training_frames
from kinedex.ops.keyframes.genetic_algorithm import evaluate, evolve, random_search, tune_gaps
from kinedex.ops.keyframes.genetic_operators import (
    OperatorSettings,
    TemplateColumns,
    crossover,
    draw_individual,
    mutate,
    mutate_gaps,
    new_population,
    select_parents,
)
from kinedex.ops.keyframes.training_task import (
    EvolutionSettings,
    Individual,
    LearningRun,
    TrainingTask,
    make_training_task,
    steady_entries,
)
from kinedex.ops.templates.templates import QuantisedTemplate
from tests.ops.keyframes.test_fitness import retrieved
from tests.oracles import learning as naive

MOST = 6
ALLOWED = 0b1111_0111


def columns(count: int = 20) -> TemplateColumns:
    random = np.random.default_rng(5)
    masks = random.integers(0, 256, count, dtype=np.uint64) & np.uint64(ALLOWED)
    masks[3] = 0
    values = random.integers(0, 256, count, dtype=np.uint64) & masks
    return TemplateColumns(masks, values, np.flatnonzero(masks).astype(np.int64), np.uint64(ALLOWED))


def breeding(**changes: float) -> OperatorSettings:
    return OperatorSettings(**changes)  # type: ignore[arg-type]


def sound(people: object, row: int) -> Individual:
    """The individual as a query, which refuses what is none; its keyframes stay within the allowed features."""
    count = int(people.counts[row])
    assert 1 <= count <= MOST
    query = Individual(*(part[row, :count] for part in people[1:4]), *(part[row, : count - 1] for part in people[4:6]))
    assert (np.diff(query.positions) >= 0).all()
    assert query.masks.all()
    assert not (query.masks & ~np.uint64(ALLOWED)).any()
    return query


@given(st.integers(0, 2**32))
def test_an_initial_individual_is_made_of_different_columns_with_gaps_around_their_spacing(seed: int) -> None:
    people, template = new_population(1, MOST), columns()
    draw_individual(np.random.default_rng(seed), people, 0, template, breeding(), np.zeros(20, np.int64))
    query = sound(people, 0)
    assert len(query) >= 2
    assert len(set(query.positions.tolist())) == len(query)
    assert (query.masks == template.masks[query.positions]).all()
    assert (query.values == template.values[query.positions]).all()
    spacing = np.diff(query.positions)
    assert (query.lows <= spacing).all()
    assert (spacing <= query.highs).all()
    assert (query.highs <= 2 * spacing).all()


@given(st.integers(0, 2**32))
def test_the_printed_form_centres_a_gap_on_half_the_spacing(seed: int) -> None:
    people = new_population(1, MOST)
    draw_individual(np.random.default_rng(seed), people, 0, columns(), breeding(centre=0.5), np.zeros(20, np.int64))
    query = sound(people, 0)
    spacing = np.diff(query.positions)
    assert (query.lows <= np.ceil(spacing / 2)).all()
    assert (query.highs >= np.floor(spacing / 2)).all()


def test_half_of_the_printed_gaps_exclude_the_templates_own_spacing() -> None:
    people, taken, random = new_population(1, MOST), np.zeros(20, np.int64), np.random.default_rng(1)
    inside = []
    for _ in range(2000):
        draw_individual(random, people, 0, columns(), breeding(centre=0.5), taken)
        query = sound(people, 0)
        inside += (query.highs >= np.diff(query.positions))[np.diff(query.positions) > 6].tolist()
    assert 0.4 < np.mean(inside) < 0.6


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12), st.integers(1, 9), st.floats(0, 1, exclude_max=True))
def test_universal_sampling_is_bakers_wheel(fitness: list[float], count: int, offset: float) -> None:
    chosen = np.zeros(count, np.int64)
    select_parents(np.array(fitness), np.arange(len(fitness)), chosen, offset)
    expected = naive.universal_sampling(fitness, count, offset)
    # a pointer on a boundary, to the last digit, may fall to either side
    total = sum(fitness) or float(len(fitness))
    edges = np.cumsum(fitness if sum(fitness) else [1.0] * len(fitness))
    pointers = (offset + np.arange(count)) * total / count
    clear = np.abs(pointers[:, None] - edges[None, :]).min(axis=1) > 1e-9
    assert chosen[clear].tolist() == np.array(expected)[clear].tolist()


def test_the_fitter_an_individual_the_more_often_it_is_a_parent() -> None:
    chosen = np.zeros(10, np.int64)
    select_parents(np.array([0.5, 0.3, 0.2, 0.0]), np.arange(4), chosen, 0.5)
    assert np.bincount(chosen, minlength=4).tolist() == [5, 3, 2, 0]


@given(st.integers(0, 2**32))
def test_offspring_have_keyframes_of_both_parents_and_of_nobody_else(seed: int) -> None:
    random, people, taken = np.random.default_rng(seed), new_population(3, MOST), np.zeros(20, np.int64)
    for row in (0, 1):
        draw_individual(random, people, row, columns(), breeding(), taken)
    parents = [sound(people, 0), sound(people, 1)]
    crossover(random, people, 0, 1, 2, breeding(), taken)
    child = sound(people, 2)
    of_parents = [set(zip(p.masks.tolist(), p.values.tolist(), p.positions.tolist(), strict=True)) for p in parents]
    own = list(zip(child.masks.tolist(), child.values.tolist(), child.positions.tolist(), strict=True))
    assert len(set(own)) == len(own)
    assert set(own) <= of_parents[0] | of_parents[1]
    assert set(own) & of_parents[0]
    assert set(own) & of_parents[1] or len(own) == MOST


@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.5, 1.0]))
def test_mutated_individuals_are_queries_and_change_in_one_way(seed: int, share: float) -> None:
    random, people, template = np.random.default_rng(seed), new_population(1, MOST), columns()
    draw_individual(random, people, 0, template, breeding(), np.zeros(20, np.int64))
    for _ in range(30):
        before = sound(people, 0)
        before = Individual(
            *(getattr(before, name).copy() for name in ("masks", "values", "positions", "lows", "highs"))
        )
        mutate(random, people, 0, template, breeding(open_share=share))
        after = sound(people, 0)
        if len(after) != len(before):
            assert abs(len(after) - len(before)) == 1
            longer, shorter = sorted((before, after), key=len, reverse=True)
            assert set(shorter.positions.tolist()) <= set(longer.positions.tolist())
        elif (after.masks != before.masks).any():
            assert np.count_nonzero(after.masks != before.masks) == 1
            assert (after.lows == before.lows).all()
            assert (after.highs == before.highs).all()
            if share == 0.0:
                assert abs(after.fixed - before.fixed) == 1


def test_gaps_change_by_up_to_a_share_of_the_spacing() -> None:
    people, random = new_population(1, 2), np.random.default_rng(3)
    seen = set()
    for _ in range(300):
        people.counts[0], people.positions[0], people.lows[0, 0], people.highs[0, 0] = 2, [4, 24], 15, 30
        mutate_gaps(random, people, 0)
        low, high = int(people.lows[0, 0]), int(people.highs[0, 0])
        assert 0 <= low <= high
        assert 5 <= low <= 25
        assert 20 <= high <= 40
        seen.add((low, high))
    assert len(seen) > 100


# ---- runs ------------------------------------------------------------------------------------------------


def material(positives: int = 6, negatives: int = 20, seed: int = 1) -> TrainingTask:
    """Clips that go through three poses in order, and others that go through two of them or in another order."""
    random = np.random.default_rng(seed)
    poses = np.array([0b0000_0001, 0b0000_0110, 0b0001_0000], np.uint64)

    def motion(order: list[int]) -> np.ndarray:
        noise = np.uint64(0b1100_0000)
        words = np.concatenate([np.full(random.integers(6, 12), poses[i], np.uint64) for i in order])
        return words | (random.integers(0, 256, len(words), dtype=np.uint64) & noise)

    orders = [[0, 1, 2]] * positives + [[[2, 1, 0], [0, 1, 0], [1, 2, 1], [0, 2, 0]][i % 4] for i in range(negatives)]
    frames = training_frames([motion(order) for order in orders], 8)
    mask = np.full(27, 0b0011_1111, np.uint64)
    return make_training_task(frames, positives, QuantisedTemplate(mask, np.repeat(poses, 9)), 0xFF)


def test_a_run_finds_the_order_of_the_poses() -> None:
    run = evolve(material(), EvolutionSettings(generations=40), 7)
    hit = retrieved(material().frames, run.query)
    assert run.fitness == 1.0
    assert hit.tolist() == [True] * 6 + [False] * 20


def test_a_run_follows_from_its_seed_alone() -> None:
    one, again, other = (
        evolve(material(), EvolutionSettings(generations=20), seed) for seed in ((7, 3), (7, 3), (7, 4))
    )
    assert one.query.key() == again.query.key()
    assert (one.history == again.history).all()
    assert one.query.key() != other.query.key()


def test_the_best_never_gets_worse_and_its_fitness_is_what_a_search_says() -> None:
    given_ = material(seed=4)
    evolution = EvolutionSettings(generations=30)
    run = evolve(given_, evolution, 2)
    assert run.history.shape == (31, 4)
    assert (np.diff(run.history[:, 3]) >= 0).all()
    assert ((run.history >= 0) & (run.history <= 1 + 1e-12)).all()
    hit = retrieved(given_.frames, run.query)
    assert run.fitness == fitness_of(float(hit[:6].sum()), float(hit[6:].sum()), 6.0, 2.0)
    assert evaluate(given_, run.query, evolution)[2:] == (run.fitness, run.rank)
    assert 50 < run.evaluated <= evolution.budget == 50 + 30 * 10


def test_the_same_query_from_other_columns_is_judged_anew_where_columns_cost() -> None:
    people = new_population(2, MOST)
    for row, last in ((0, 9), (1, 12)):
        people.counts[row] = 2
        people.masks[row, :2] = people.values[row, :2] = 1
        people.positions[row, :2] = 3, last
        people.highs[row, 0] = 20
    equal = getattr(genetics._equal, "py_func", genetics._equal)  # the very function where nothing is compiled
    assert equal(people, 0, 1, False)
    assert not equal(people, 0, 1, True)
    people.positions[1, 1] = 9
    assert equal(people, 0, 1, True)


def test_mutations_are_as_likely_as_their_odds() -> None:
    template, people = columns(), new_population(2, MOST)
    for odds, part in (((1.0, 0.0), "counts"), ((0.0, 1.0), "masks"), ((0.0, 0.0), "lows")):
        only = breeding(keyframe_odds=odds[0], entry_odds=odds[1])
        for seed in range(20):
            random = np.random.default_rng(seed)
            draw_individual(random, people, 0, template, only, np.zeros(20, np.int64))
            before = sound(people, 0)
            mutate(random, people, 0, template, only)
            after = sound(people, 0)
            if part != "counts":
                assert len(before) == len(after)
            if part == "lows":
                assert (before.masks == after.masks).all()
            if part == "masks":
                assert before.gaps == after.gaps


def test_costs_prefer_open_entries_and_narrow_gaps_but_do_not_count_as_fitness() -> None:
    given_, costly = material(), EvolutionSettings(parsimony=0.01, gap_cost=0.001)
    query = Individual(
        np.array([1, 16], np.uint64), np.array([1, 16], np.uint64), np.array([0, 20]), np.array([3]), np.array([40])
    )
    fitness, rank = evaluate(given_, query, costly)[2:]
    assert rank == pytest.approx(fitness - 0.02 - 0.037)
    # six of the template's 27 columns lie after the second keyframe, none before the first
    assert evaluate(given_, query, EvolutionSettings(outside_cost=0.9))[2:] == pytest.approx(
        (fitness, fitness - 0.9 * 6 / 27)
    )
    free, cheap = evolve(given_, EvolutionSettings(generations=60), 5), evolve(given_, costly, 5)
    assert cheap.query.fixed < free.query.fixed
    wide = evolve(given_, EvolutionSettings(generations=60, outside_cost=0.5), 5)
    assert wide.fitness == 1.0
    assert np.ptp(wide.query.positions) > np.ptp(free.query.positions)


def test_a_tempo_asks_that_examples_be_found_even_if_they_were_slower_or_faster() -> None:
    words = np.array([1] + [0] * 9 + [2], np.uint64)
    given_ = make_training_task(
        training_frames([words, words], 2), 1, QuantisedTemplate(np.array([3], np.uint64), np.array([1], np.uint64)), 3
    )

    def found(low: int, high: int, tempo: float) -> tuple[float, float]:
        masks = np.array([1, 2], np.uint64)
        query = Individual(masks, masks, np.array([0, 10]), np.array([low]), np.array([high]))
        return evaluate(given_, query, EvolutionSettings(tempo=tempo))[:2]

    assert found(10, 10, 0.0) == (1.0, 1.0)
    assert found(10, 10, 0.25) == (0.0, 1.0)
    assert found(8, 13, 0.25) == (1.0, 1.0)
    assert found(8, 12, 0.25) == (0.0, 1.0)


def test_tuned_gaps_are_no_worse_and_leave_the_keyframes_alone() -> None:
    given_ = material(seed=9)
    start = Individual(
        np.array([1, 6, 16], np.uint64), np.array([1, 6, 16], np.uint64), np.array([4, 13, 22]),
        np.array([0, 0]), np.array([0, 0]),
    )  # fmt: skip
    tuned = tune_gaps(given_, start, EvolutionSettings(), 3)
    assert evaluate(given_, start, EvolutionSettings())[2] == 0.0
    assert tuned.fitness == 1.0
    assert (tuned.query.masks == start.masks).all()
    assert (tuned.query.positions == start.positions).all()


def check_consensus(given: TrainingTask, runs: list[LearningRun], evolution: EvolutionSettings) -> Consensus:
    """Find the consensus of runs and check the properties that every consensus has."""
    found = find_consensus(given, runs, evolution, 1, 5)
    ranks = [run.rank for run in runs]
    assert found.median == np.median(ranks)
    assert found.best == max(ranks)
    assert found.rank >= found.median
    assert evaluate(given, found.query, evolution)[2:] == (found.fitness, found.rank)
    again = find_consensus(given, runs, evolution, 1, 5)
    assert again.query.key() == found.query.key()
    if found.origin == "best run":
        assert found.rank == found.best
    return found


def test_evolved_runs_agree_on_a_query_no_worse_than_their_median() -> None:
    evolution = EvolutionSettings(generations=8)
    check_consensus(
        material(seed=3), [evolve(material(seed=3), evolution, (1, number)) for number in range(6)], evolution
    )


def test_random_search_spends_the_same_budget_on_initial_individuals() -> None:
    run = random_search(material(), EvolutionSettings(generations=10), 1)
    assert run.history.shape[0] == 1
    assert run.evaluated <= EvolutionSettings(generations=10).budget
    assert run.query.masks.all()


def test_what_cannot_be_learned_from() -> None:
    given_ = material()
    wild = QuantisedTemplate(np.zeros(3, np.uint64), np.zeros(3, np.uint64))
    with pytest.raises(ParameterError, match="wildcards alone"):
        make_training_task(given_.frames, 6, wild, 0xFF)
    with pytest.raises(ParameterError, match="positives"):
        make_training_task(given_.frames, 0, QuantisedTemplate(given_.masks, given_.values), 0xFF)


def test_steady_entries_hold_in_the_columns_around_as_well() -> None:
    template = QuantisedTemplate(np.array([3, 3, 3, 1, 1], np.uint64), np.array([3, 3, 2, 0, 0], np.uint64))
    steady = steady_entries(template, 1)
    assert steady.mask.tolist() == [3, 2, 0, 1, 1]
    assert steady.value.tolist() == [3, 2, 0, 0, 0]
    assert (steady_entries(template, 0).mask == template.mask).all()
