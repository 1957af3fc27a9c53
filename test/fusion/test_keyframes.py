# SPDX-License-Identifier: BSD-3-Clause
import dataclasses

import numpy as np

from ceiling_dso_ros.dso.status import KeyframeEstimate
from ceiling_dso_ros.fusion.keyframes import KeyframeChain


def keyframe(key, x, segment=0):
    T = np.eye(4)
    T[0, 3] = x
    return KeyframeEstimate(key, key * 10**9, segment, T, (0.0, 0.0), leaves=False)


def linked(chain, keyframes, first_node=1):
    for node, new in enumerate(chain.update(keyframes), first_node):
        chain.link(node, new)


def test_new_keyframes_come_once_and_in_order():
    chain = KeyframeChain()
    assert [k.keyframe_id for k in chain.update([keyframe(1, 1.0), keyframe(0, 0.0)])] == [0, 1]
    assert [k.keyframe_id for k in chain.update([keyframe(0, 0.0), keyframe(1, 1.0), keyframe(2, 2.0)])] == [2]


def test_motions_are_those_of_the_last_status_that_holds_both():
    chain = KeyframeChain()
    linked(chain, [keyframe(0, 0.0), keyframe(1, 1.0)])
    chain.update([keyframe(0, 5.0), keyframe(1, 6.1)])
    ((node, T, _, _),) = chain.refinements()
    assert node == 2
    np.testing.assert_allclose(T[0, 3], 1.1)
    chain.update([keyframe(1, 7.0)])
    assert list(chain.refinements()) == []


def test_a_keyframe_that_left_amid_the_chain_ties_nothing_any_more():
    chain = KeyframeChain()
    linked(chain, [keyframe(0, 0.0), keyframe(1, 1.0), keyframe(2, 2.0)])
    chain.update([keyframe(0, 0.0), keyframe(2, 2.0)])
    assert list(chain.refinements()) == []


def test_segments_are_not_tied():
    chain = KeyframeChain()
    linked(chain, [keyframe(0, 0.0)])
    (new,) = chain.update([keyframe(1, 1.0, segment=1)])
    assert not chain.continues(new)
    assert chain.motion_to(new) is None
    chain.link(2, new)
    assert chain.segment == 1
    assert list(chain.refinements()) == []
    assert chain.from_newest(0, np.eye(4)) is None


def test_a_frame_is_seen_from_the_newest_node_whatever_its_own_keyframe():
    chain = KeyframeChain()
    linked(chain, [keyframe(0, 0.0), keyframe(1, 1.0)])
    T = np.eye(4)
    T[0, 3] = 1.5
    np.testing.assert_allclose(chain.from_newest(0, T)[0, 3], 0.5)
    assert chain.from_newest(77, T) is None


def test_a_window_that_comes_late_is_ignored():
    chain = KeyframeChain()
    linked(chain, [keyframe(0, 0.0), keyframe(1, 1.0), keyframe(2, 2.0)])
    assert chain.update([keyframe(0, 9.0), keyframe(1, 9.0)]) == []
    np.testing.assert_allclose([T[0, 3] for _, T, _, _ in chain.refinements()], [1.0, 1.0])


def test_an_odometry_that_was_reset_counts_anew():
    chain = KeyframeChain()
    linked(chain, [keyframe(5, 0.0), keyframe(6, 1.0)])
    first, second = (KeyframeEstimate(k, (100 + k) * 10**9, 0, np.eye(4), (0.0, 0.0), leaves=False) for k in range(2))
    assert [k.keyframe_id for k in chain.update([first, second])] == [0, 1]
    assert not chain.continues(first)
    assert chain.motion_to(first) is None


def test_a_node_that_is_an_image_moves_with_its_keyframe():
    chain, T = KeyframeChain(), np.eye(4)
    T[0, 3] = 0.25
    chain.update([keyframe(0, 0.0)])
    chain.link(1, chain.known(0), T)
    (new,) = chain.update([keyframe(0, 5.0), keyframe(1, 6.0)])
    np.testing.assert_allclose(chain.motion_to(new)[0, 3], 0.75)
    np.testing.assert_allclose(chain.from_newest(0, T)[0, 3], 0.0)
    chain.link(2, new)
    ((node, T, _, _),) = chain.refinements()
    assert (node, T[0, 3]) == (2, 0.75)


def test_an_odometry_that_counts_anew_is_noticed_by_any_id_it_shares():
    """A first map that has as many keyframes as the one before has the same newest id."""
    chain = KeyframeChain()
    linked(chain, [keyframe(0, 0.0), keyframe(1, 1.0)])
    anew = [dataclasses.replace(keyframe(key, 7.0 + key), stamp_ns=(10 + key) * 10**9) for key in (0, 1)]
    (first, second) = chain.update(anew)
    assert (first.keyframe_id, second.keyframe_id) == (0, 1)
    assert not chain.continues(first)
    late = [keyframe(0, 0.0), keyframe(1, 1.0)]
    assert chain.update(late) == []
