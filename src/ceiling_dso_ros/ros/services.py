# SPDX-License-Identifier: BSD-3-Clause
"""Services without arguments."""

from typing import Callable

import rospy
from std_srvs.srv import Trigger, TriggerRequest, TriggerResponse


def offer_trigger(name: str, act: Callable[[], str]) -> None:
    """Offer a service without arguments; act returns a message about what it did."""

    def answer(_request: TriggerRequest) -> TriggerResponse:
        message = act()
        rospy.loginfo(message)
        return TriggerResponse(True, message)

    rospy.Service(name, Trigger, answer)
