# SPDX-License-Identifier: BSD-3-Clause
"""A dynamic_reconfigure server that rejects values out of range instead of changing them."""

from typing import Any, Dict

import rospy
from dynamic_reconfigure.server import Server

from ceiling_dso_ros.io.errors import InputError


class ReconfigureServer(Server):  # type: ignore[misc]  # ROS has no types
    """dynamic_reconfigure's server for parameters of this node or of one of its groups."""

    def update_configuration(self, changes: Dict[str, Any]) -> Any:  # noqa: ANN401
        """Apply all changes or none.

        Raises:
            rospy.ServiceException: a value is out of range, or the node refuses it with an InputError; the client gets
                the message.
        """
        for name, value in changes.items():
            smallest, largest = self.type.min.get(name, ""), self.type.max.get(name, "")
            if smallest != "" and not smallest <= value <= largest:
                raise _refusal(f"{rospy.resolve_name(self.ns + name)}={value}: {smallest:g} to {largest:g}")
        try:
            return super().update_configuration(changes)
        except InputError as error:
            raise _refusal(f"{rospy.resolve_name(self.ns).rstrip('/')}: {error}") from error


def _refusal(reason: str) -> rospy.ServiceException:
    message = f"{reason}; nothing is changed"
    rospy.logwarn(message)
    return rospy.ServiceException(message)
