# SPDX-License-Identifier: BSD-3-Clause
"""A node's server without a master: its callbacks are called, and its messages collected, by the test itself."""

import time
from types import SimpleNamespace

import diagnostic_updater
import rospy
import tf2_ros


class Endpoint:
    """Stands for publishers, subscribers, services and all else that a server makes."""

    def __init__(self, *_args, **_kwargs):
        pass

    def __getattr__(self, _name):
        return lambda *_args, **_kwargs: None


def parameters_of(private):
    """Private parameters as rospy.get_param finds them."""
    return {"~": private, **{f"~{name}": value for name, value in private.items()}}


class Rosless:
    """What a server with some private parameters has connected to.

    Attributes:
        callbacks: topic -> callback.
        services: name -> handler.
        sent: topic -> number of messages.
        newest: topic -> message.
        listened: topics that have a subscriber.
        logged: what was logged as a warning or an error.
        is_shutdown: whether the node is being shut down.
        diagnostics: runs the node's report and returns its status.
    """

    def __init__(self, monkeypatch, **parameters):
        self.callbacks, self.services, self.sent, self.newest = {}, {}, {}, {}
        self.listened, self.logged, self.ends = set(), [], []
        self.is_shutdown = False
        self._task = None
        world = self

        class Publisher:
            def __init__(self, topic, *_args, **_kwargs):
                self.topic = topic

            def get_num_connections(self):
                return int(self.topic in world.listened)

            def publish(self, message):
                world.publish(self.topic, message)

        class Subscriber:
            def __init__(self, topic, _kind, callback, *_args, **_kwargs):
                self.topic = topic
                world.callbacks[topic] = callback

            def get_num_connections(self):
                return int(self.topic in world.listened)

            def unregister(self):
                world.callbacks.pop(self.topic, None)

        class Updater(Endpoint):
            def add(self, _name, task):
                world._task = task

        def log(text, *values):
            world.logged.append(text % values if values else text)

        replaced = {
            "Publisher": Publisher,
            "Subscriber": Subscriber,
            "Service": lambda name, _kind, handler: world.services.__setitem__(name, handler),
            "get_param": lambda name, default=None: parameters_of(parameters).get(name, default),
            "set_param": lambda *_: None,
            "get_name": lambda: "/robot/node",
            "resolve_name": lambda name: f"/{name.lstrip('/')}",
            "get_time": time.monotonic,
            "is_shutdown": lambda: world.is_shutdown,
            "on_shutdown": self.ends.append,
            "loginfo": lambda *_: None,
            **dict.fromkeys(("logwarn", "logerr"), log),
            **dict.fromkeys(("logwarn_throttle", "logerr_throttle"), lambda _period_s, text: log(text)),
        }
        monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: world.is_shutdown)
        for name, stand_in in replaced.items():
            monkeypatch.setattr(rospy, name, stand_in)
        for name in ("TransformBroadcaster", "TransformListener", "Buffer"):
            monkeypatch.setattr(tf2_ros, name, Endpoint)
        monkeypatch.setattr(diagnostic_updater, "Updater", Updater)
        monkeypatch.setattr("ceiling_dso_ros.ros.diagnostics.Updater", Updater)
        for server in ("dso_server", "fusion_server"):
            monkeypatch.setattr(f"ceiling_dso_ros.ros.{server}.ReconfigureServer", Endpoint)
        monkeypatch.setattr("ceiling_dso_ros.ros.dso_server.load_kernels", lambda _load: None)

    def publish(self, topic, message):
        """Called for every message that is published."""
        self.sent[topic] = self.sent.get(topic, 0) + 1
        self.newest[topic] = message

    def diagnostics(self):
        """The status that the node reports now."""
        return self._task(diagnostic_updater.DiagnosticStatusWrapper())

    def call(self, name, **request):
        """A service's response."""
        return self.services[name](SimpleNamespace(**request))

    def end(self):
        """Shut down: ends the threads of the node."""
        for end in self.ends:
            end()
