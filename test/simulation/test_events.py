# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.events import (
    KINDS,
    LIGHTS_OFF_LEVEL,
    Event,
    EventError,
    covered_light,
    flicker_factor,
    is_dropped,
    light_level,
    of_kind,
    parse_events,
    parse_live_event,
    slip_share,
)


def test_an_event_without_a_time_happens_where_it_usually_does():
    slips = parse_events(["slip"], 60.0)
    assert [event.start_s for event in slips] == [15.0, 30.0, 45.0]
    assert {event.duration_s for event in slips} == {0.5}


def test_times_can_be_given_and_events_are_sorted():
    events = parse_events(["cover@20+3.5", "slip@5", "bump@10"], 60.0)
    assert events == [Event("slip", 5.0, 0.5), Event("bump", 10.0, 0.6), Event("cover", 20.0, 3.5)]
    assert events[-1].end_s == 23.5
    assert of_kind(events, "bump") == [events[1]]


@pytest.mark.parametrize(
    "text", ["", "fire", "slip@", "slip@x", "slip@1+", "slip@1.2.3", "slip@70", "slip@5+0", "Slip"]
)
def test_what_is_no_event_is_told_in_one_line(text):
    with pytest.raises(EventError) as info:
        parse_events([text], 60.0)
    assert text in str(info.value) and "\n" not in str(info.value)


@pytest.mark.parametrize("text", ["slip", "slip+0.5", "slip@7.25", " slip@7.25+0.5"])
def test_an_event_may_come_while_the_robot_drives(text):
    assert parse_live_event(text, 7.25, []) == Event("slip", 7.25, 0.5)


@pytest.mark.parametrize("text", ["slip@7.2", "lights_on", "slip@", "+1", "", "fire"])
def test_what_cannot_happen_any_more_is_told_in_one_line(text):
    with pytest.raises(EventError) as info:
        parse_live_event(text, 7.25, [])
    assert text in str(info.value) and "\n" not in str(info.value)


def test_lamps_that_are_off_can_go_on():
    assert parse_live_event("lights_on", 7.25, [Event("lights_off", 3.0, 0.3)]) == Event("lights_on", 7.25, 0.3)


def test_half_of_a_slipping_wheels_rotation_is_lost():
    share = slip_share([Event("slip", 1.0, 0.5), Event("bump", 2.0, 0.5)], np.array([0.9, 1.0, 1.4, 1.5, 2.1]))
    np.testing.assert_array_equal(share, [0.0, 0.5, 0.5, 0.0, 0.0])


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_can_be_laid_over_a_short_sequence(kind):
    assert parse_events([kind], 12.0)


def test_lights_go_out_and_on_again():
    events = parse_events(["lights_off@2", "lights_on@4"], 10.0)
    level = light_level(events, np.array([0.0, 1.9, 2.5, 3.9, 4.5, 9.0]))
    np.testing.assert_allclose(level, [1, 1, LIGHTS_OFF_LEVEL, LIGHTS_OFF_LEVEL, 1, 1])
    assert light_level(parse_events(["lights_on@4"], 10.0), np.array([1.0]))[0] == LIGHTS_OFF_LEVEL


def test_flicker_is_the_mean_over_the_exposure():
    events = parse_events(["flicker@1+2"], 10.0)
    assert flicker_factor(events, 0.5, 0.005) == 1.0
    assert flicker_factor(events, 1.5, 0.010) == pytest.approx(1.0), "a whole period of 100 Hz"
    fine = 1.2 + np.linspace(-0.0015, 0.0015, 2001) + 0.0012
    mean = np.mean(1 + 0.25 * np.sin(2 * np.pi * 100 * fine))
    assert flicker_factor(events, 1.2012, 0.003) == pytest.approx(mean, abs=1e-4)


def test_most_images_of_a_gap_are_dropped_and_none_outside():
    events = parse_events(["drop_frames@2+3"], 10.0)
    rng = np.random.default_rng(0)
    dropped = [is_dropped(events, time_s, rng) for time_s in np.arange(0.0, 10.0, 0.01)]
    assert not any(dropped[:200]) and not any(dropped[500:])
    assert 0.7 < np.mean(dropped[200:500]) < 0.9


def test_a_cover_slides_over_the_lens_and_away():
    events = parse_events(["cover@2+3"], 10.0)
    light = np.random.default_rng(0).uniform(0.4, 0.9, (20, 848)).astype(np.float32)

    def after(time_s):
        return covered_light(events, time_s, light)

    np.testing.assert_array_equal(after(1.9), light)
    np.testing.assert_array_equal(after(2.1)[:, -1], light[:, -1])
    assert (after(2.1)[:, 0] < 0.1).all()
    assert np.ptp(after(3.5)) == 0.0, "nothing of the ceiling shines through"
    np.testing.assert_array_equal(after(5.1)[:, 0], light[:, 0])
    assert (after(5.1)[:, -1] < 0.1).all()
    np.testing.assert_array_equal(after(5.5), light)
