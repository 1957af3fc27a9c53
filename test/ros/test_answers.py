# SPDX-License-Identifier: BSD-3-Clause
"""Simulated time waits for a node that answers, and for no other."""

import threading
import time
from io import BytesIO

import pytest

pytest.importorskip("ceiling_dso_ros.cfg", reason="needs ROS and the built workspace")

import rospy
from nav_msgs.msg import Path
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from ceiling_dso_ros.msg import VisualOdometryStatus
from ceiling_dso_ros.ros import answers, topic_writer
from ceiling_dso_ros.ros.answers import TRUSTED_AFTER, Answers
from ceiling_dso_ros.ros.topic_writer import SimulatedClock

pytestmark = pytest.mark.ros
EPOCH_NS = 1_700_000_000_000_000_000


class Node:
    """One that answers on a topic, without ROS."""

    def __init__(self):
        self.resolved_name = "/status"
        self.connections = 1
        self.warnings = []

    def subscribe(self, _topic, _kind, callback, **_):
        self.callback = callback
        return self

    def get_num_connections(self):
        return self.connections

    def answer(self, number, kind=VisualOdometryStatus):
        buffer = BytesIO()
        Header(seq=7, stamp=rospy.Time(0, EPOCH_NS + number), frame_id="vo").serialize(buffer)
        message = rospy.AnyMsg().deserialize(buffer.getvalue())
        message._connection_header = {"message_definition": kind._full_text}
        self.callback(message)


@pytest.fixture
def node(monkeypatch):
    node = Node()
    monkeypatch.setattr(rospy, "Subscriber", node.subscribe)
    monkeypatch.setattr(rospy, "logwarn_once", node.warnings.append)
    monkeypatch.setattr(rospy, "logwarn", node.warnings.append)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(answers, "ANSWER_LIMIT_S", 0.1)
    return node


def publish(waiting, number):
    waiting.wait()
    waiting.ask(EPOCH_NS + number)


def test_nobody_waits_for_a_node_that_has_never_answered(node):
    waiting = Answers("status")
    for number in range(5):
        publish(waiting, number)
    assert node.warnings == []


def test_the_next_image_waits_for_the_answer(node, monkeypatch):
    monkeypatch.setattr(answers, "ANSWER_LIMIT_S", 60.0)
    waiting = Answers("status")
    publish(waiting, 1)
    node.answer(1)
    publish(waiting, 2)
    published = threading.Event()
    threading.Thread(target=lambda: (publish(waiting, 3), published.set()), daemon=True).start()
    assert not published.wait(0.2)
    node.answer(1)
    assert not published.wait(0.2), "that is the answer to another one"
    node.answer(2)
    assert published.wait(30.0)


def test_a_node_that_is_slow_from_the_start_is_waited_for(node, monkeypatch):
    monkeypatch.setattr(answers, "ANSWER_LIMIT_S", 60.0)
    waiting = Answers("status")
    publish(waiting, 1)
    publish(waiting, 2)
    node.answer(1)
    threading.Timer(0.2, node.answer, [2]).start()
    start_s = time.monotonic()
    publish(waiting, 3)
    assert time.monotonic() - start_s > 0.1
    assert node.warnings == []


def test_a_node_that_leaves_images_out_is_not_waited_for_until_it_answers_again(node):
    waiting = Answers("status")
    node.answer(0)
    publish(waiting, 1)
    publish(waiting, 2)
    assert len(node.warnings) == 1 and "/status" in node.warnings[0]
    for number in range(3, 30):  # every third one is answered
        publish(waiting, number)
        if number % 3 == 0:
            node.answer(number)
    assert len(node.warnings) == 1
    for number in range(30, 31 + TRUSTED_AFTER):
        publish(waiting, number)
        node.answer(number)
    publish(waiting, 50)
    publish(waiting, 51)
    assert len(node.warnings) == 2, "it was waited for again"


def test_a_node_that_has_ended_is_not_waited_for_and_its_successor_begins_anew(node):
    waiting = Answers("status")
    node.answer(0)
    publish(waiting, 1)
    node.connections = 0
    publish(waiting, 2)
    publish(waiting, 3)
    node.connections = 1
    publish(waiting, 4)
    publish(waiting, 5)
    assert node.warnings == []


def test_messages_without_a_header_are_no_answers(node):
    waiting = Answers("status")
    node.answer(1, Path)
    assert node.warnings == []
    node.answer(1, TFMessage)
    assert len(node.warnings) == 1 and "header" in node.warnings[0]
    publish(waiting, 1)


class Time:
    """/clock without ROS, and a real time that passes by sleeping."""

    def __init__(self):
        self.published_ns, self.now_s = [], 0.0

    def __call__(self, *_, **__):
        return self

    def publish(self, message):
        self.published_ns.append(message.clock.to_nsec())

    def monotonic(self):
        return self.now_s

    def sleep(self, duration_s):
        self.now_s += duration_s


@pytest.fixture
def real(monkeypatch):
    real = Time()
    monkeypatch.setattr(topic_writer, "time", real)
    monkeypatch.setattr(rospy, "Publisher", real)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    return real


def test_the_clock_keeps_its_rate_and_never_catches_up(real):
    clock = SimulatedClock(rate=2.0)
    for number in range(11):
        clock.advance(EPOCH_NS + number * 100_000_000)
    assert real.now_s == pytest.approx(0.5)
    real.now_s += 3.0  # rendering takes longer
    for number in range(11, 22):
        clock.advance(EPOCH_NS + number * 100_000_000)
    assert real.now_s == pytest.approx(4.0)
    assert real.published_ns == [EPOCH_NS + number * 100_000_000 for number in range(22)]


def test_a_clock_without_a_rate_waits_for_nothing_and_never_goes_back(real):
    clock = SimulatedClock(rate=0.0)
    for number in (0, 5, 3, 6):
        clock.advance(EPOCH_NS + number)
    assert real.now_s == 0.0
    assert real.published_ns == [EPOCH_NS + number for number in (0, 5, 5, 6)]
