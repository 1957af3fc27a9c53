# SPDX-License-Identifier: BSD-3-Clause
"""The server of map_node: builds a map of the site of the keyframes, and finds the robot in it."""

import queue
import threading
import time
import traceback
from typing import Callable, Optional, Union

import numpy as np
import rospy
from diagnostic_updater import DiagnosticStatusWrapper
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from std_srvs.srv import Empty, EmptyRequest, EmptyResponse, SetBool, SetBoolRequest, SetBoolResponse

from ceiling_dso_ros.dso import PinholeCamera
from ceiling_dso_ros.io.errors import InputError, OutputError, one_line
from ceiling_dso_ros.io.ros_messages import planar_pose
from ceiling_dso_ros.msg import KeyframeView, LeftKeyframe, MapStatus
from ceiling_dso_ros.ros import diagnostics, parameters
from ceiling_dso_ros.ros.conversions import covariance_from_message
from ceiling_dso_ros.ros.kernels import load_kernels
from ceiling_dso_ros.ros.keyframe_messages import left_from_message, mount_of, view_from_message
from ceiling_dso_ros.ros.map_frame import MapFrame
from ceiling_dso_ros.ros.node import publishing
from ceiling_dso_ros.ros.node_parameters import MapParameters
from ceiling_dso_ros.ros.planar_messages import IN_PLANE
from ceiling_dso_ros.ros.site_publisher import STATES, SitePublisher
from ceiling_dso_ros.slam import warmup
from ceiling_dso_ros.slam.deciding import Place
from ceiling_dso_ros.slam.map_file import read_map, require_camera, write_map
from ceiling_dso_ros.slam.record_maker import NewRecord, RecordMaker
from ceiling_dso_ros.slam.records import RecordCamera
from ceiling_dso_ros.slam.session import MapSession
from ceiling_dso_ros.slam.site_map import SiteMap
from ceiling_dso_ros.srv import LoadMap, LoadMapRequest, LoadMapResponse, SaveMap, SaveMapRequest, SaveMapResponse

QUEUE_SIZE = 200  # every keyframe counts
BUFFER_BYTES = 2**24
WARNING_PERIOD_S = 5.0
GOOD = (MapStatus.MAPPING, MapStatus.LOCALISED)
NO_MAP = "there is no map, and none is built: load one, or resume mapping"
NO_KEYFRAME = "no keyframe yet: dso_node and fusion_node hand them over once the scale is known"

KeyframeMessage = Union[KeyframeView, LeftKeyframe]


class MapServer:
    """Builds a map of the site, and finds the robot in it.

    Subscribes:
        visual_odometry/views (KeyframeView): of dso_node.
        fusion/left_keyframes (LeftKeyframe): of fusion_node.
        odometry/filtered (nav_msgs/Odometry): of fusion_node, for the transform.
        initialpose (geometry_msgs/PoseWithCovarianceStamped): where the robot is, roughly, in the map.

    Publishes:
        localization/pose (geometry_msgs/PoseWithCovarianceStamped): base_link in the map at the newest keyframe, with
            each keyframe while the place is known.
        map/status (MapStatus): with each keyframe and after services, latched.
        map/keyframes (geometry_msgs/PoseArray), map/points, map/loops (sensor_msgs/PointCloud2): the map, latched, when
            somebody listens; map/hypotheses (geometry_msgs/PoseArray): places that are possible.
        /tf: map -> odom while the place is known, ~transform_tolerance ahead.
        /diagnostics

    Services:
        ~save_map (SaveMap), ~load_map (LoadMap): write the map, read another one.
        global_localization (std_srvs/Empty): forget where the robot is and search.
        ~pause_mapping (std_srvs/SetBool): true: the map does not change any more; false: it is built on.

    Parameters (private, read at start): `MapParameters`.
    """

    def __init__(self) -> None:
        """Read the parameters, load the compiled kernels and connect.

        Raises:
            InputError: a parameter is wrong.
        """
        own: MapParameters
        (own,) = parameters.read(MapParameters)
        self._map_frame = own.map_frame.lstrip("/")
        self._file, self._save_to = parameters.file_path(own.map), parameters.file_path(own.save)
        self._lock = threading.RLock()  # of the session
        self._session: Optional[MapSession] = None  # None until camera and mount are known
        self._loaded: Optional[SiteMap] = None  # what it begins with
        self._mapping = own.mapping
        self._camera: Optional[PinholeCamera] = None  # of the views
        self._mount: Optional[np.ndarray] = None  # (4, 4) T_base_camera
        self._maker, self._views, self._poses = RecordMaker(), diagnostics.Stream(own.silence), diagnostics.Stream(1e9)
        self._work: queue.Queue[Optional[KeyframeMessage]] = queue.Queue(QUEUE_SIZE)
        self._complaint = ""
        self._status = MapStatus(state=MapStatus.SEARCHING, why=NO_KEYFRAME)
        if self._file is not None:
            try:
                self._loaded = read_map(self._file)
            except InputError as error:  # the robot drives without a map
                self._complaint = one_line(str(error))
                rospy.logerr(self._complaint)
        load_kernels(warmup.load_kernels)
        self._frame = MapFrame(self._map_frame, own.odom_frame.lstrip("/"), own.transform_tolerance, own.publish_tf)
        self._publisher = SitePublisher(self._map_frame, self._site)
        self._offer_services()
        diagnostics.Diagnostics(self._report, "map")
        self._connect()
        self._tell()

    def spin(self) -> None:
        """Work until the node is shut down.

        Raises:
            OutputError: the map cannot be written at the end.
        """
        rospy.on_shutdown(lambda: self._work.put(None))
        while (message := self._work.get()) is not None:
            try:
                with publishing():
                    self._use(message)
            except Exception:  # concerns one keyframe
                rospy.logerr_throttle(WARNING_PERIOD_S, f"a keyframe was not used: {traceback.format_exc()}")
        site = self._site()
        if self._save_to is not None and site is not None and site.keyframes:
            write_map(self._save_to, site)

    def _connect(self) -> None:
        for topic, kind, stream in (
            ("visual_odometry/views", KeyframeView, self._views),
            ("fusion/left_keyframes", LeftKeyframe, self._poses),
        ):
            rospy.Subscriber(topic, kind, self._receiver(stream), queue_size=QUEUE_SIZE, buff_size=BUFFER_BYTES)
        rospy.Subscriber("odometry/filtered", Odometry, self._on_odometry, queue_size=QUEUE_SIZE, tcp_nodelay=True)
        rospy.Subscriber("initialpose", PoseWithCovarianceStamped, self._on_initial_pose, queue_size=1)

    def _offer_services(self) -> None:
        rospy.Service("~save_map", SaveMap, self._save)
        rospy.Service("~load_map", LoadMap, self._load)
        rospy.Service("~pause_mapping", SetBool, self._pause)
        rospy.Service("global_localization", Empty, self._search)

    # Input

    def _receiver(self, stream: diagnostics.Stream) -> Callable[[KeyframeMessage], None]:
        def receive(message: KeyframeMessage) -> None:
            stream.heard()
            try:
                self._work.put_nowait(message)
            except queue.Full:
                stream.complain("the computer is too slow for the map: a keyframe is left out")

        return receive

    def _on_odometry(self, message: Odometry) -> None:
        try:
            self._frame.add(message.header.stamp.to_nsec(), planar_pose(message.pose.pose))
        except ValueError as error:
            rospy.logwarn_throttle(WARNING_PERIOD_S, one_line(f"{rospy.resolve_name('odometry/filtered')}: {error}"))

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        try:
            covariance = covariance_from_message(message.pose.covariance)[np.ix_(IN_PLANE, IN_PLANE)]
            place = Place(planar_pose(message.pose.pose), covariance + 1e-6 * np.eye(3))
            if np.linalg.eigvalsh(place.covariance)[0] <= 0.0:
                raise ValueError("its covariance is not positive")
            if message.header.frame_id.lstrip("/") not in ("", self._map_frame):
                raise ValueError(f"it is in {message.header.frame_id[:100]}, not in {self._map_frame}")
        except ValueError as error:
            rospy.logwarn(one_line(f"initialpose is not used: {error}"))
            return
        with self._lock:
            if self._session is not None:
                self._session.believe(place)
                self._lose("somebody has said where the robot is: keyframes must agree")

    # Work

    def _use(self, message: KeyframeMessage) -> None:
        is_view = isinstance(message, KeyframeView)
        try:
            if isinstance(message, KeyframeView):
                view = view_from_message(message)
                self._maker.add_view(view)
                self._camera = view.camera
            else:
                self._maker.add_pose(left_from_message(message))
                self._mount = mount_of(message)
        except ValueError as error:
            (self._views if is_view else self._poses).complain(str(error))
            return
        if self._camera is None or self._mount is None:
            return
        for new in self._maker.take(self._mount):
            with self._lock:
                self._add(new, RecordCamera.of(self._camera, self._mount))

    def _add(self, new: NewRecord, camera: RecordCamera) -> None:
        start_s = time.perf_counter()
        session = self._session_of(camera)
        if session is None:
            self._lose(self._complaint or NO_MAP)
            return
        found = session.add(new)
        status = self._status
        status.header.stamp = rospy.Time(0, new.newest_ns)
        status.state, status.why = STATES[found.state, session.is_mapping, len(found.hypotheses) > 0], found.reason
        status.hypotheses, status.quality = len(found.hypotheses), found.quality
        if status.state not in GOOD:
            self._frame.lose()
        elif found.place is not None:
            self._frame.find(new.newest_ns, found.place.pose)
            self._publisher.publish_place(status.header.stamp, found.place)
        self._publisher.publish_hypotheses(status.header.stamp, found.hypotheses)
        self._publisher.changed()
        status.processing_ms = 1e3 * (time.perf_counter() - start_s)
        self._tell()

    def _session_of(self, camera: RecordCamera) -> Optional[MapSession]:
        """The session for records of a camera; None if there is no map for them, and the complaint says why."""
        if self._session is None or not self._session.camera.same_as(camera):
            site = self._site()
            try:
                if site is not None and site.keyframes:
                    require_camera(self._file or "the map", site, camera)
            except InputError as error:
                self._complaint = one_line(str(error))
                return None
            if site is None and not self._mapping:
                return None
            self._complaint, self._loaded = "", None
            self._session = MapSession(camera, site if site is not None and site.keyframes else None, self._mapping)
        return self._session

    def _lose(self, why: str) -> None:
        """The place is not known any more."""
        self._frame.lose()
        self._status.state, self._status.why = MapStatus.SEARCHING, why
        self._status.hypotheses, self._status.quality = 0, 0.0
        self._tell()

    def _tell(self) -> None:
        site = self._site()
        self._status.header.frame_id = self._map_frame
        self._status.keyframes = 0 if site is None else len(site.keyframes)
        self._status.loops = 0 if site is None else sum(edge.is_loop for edge in site.edges)
        self._status.rejected = self._views.rejected + self._poses.rejected
        self._publisher.publish_status(self._status)

    def _site(self) -> Optional[SiteMap]:
        with self._lock:
            return self._loaded if self._session is None else self._session.site

    # Services

    def _save(self, request: SaveMapRequest) -> SaveMapResponse:
        try:
            path = parameters.file_path(request.file) or self._file
            site = self._site()
            if site is None or not site.keyframes:
                return SaveMapResponse(False, "there is no map yet")
            if path is None:
                return SaveMapResponse(False, "no file is named, and none was loaded")
            write_map(path, site)  # what is written does not change, so the robot is localised meanwhile
        except (InputError, OutputError) as error:
            return SaveMapResponse(False, one_line(str(error)))
        return SaveMapResponse(True, f"{path}: {len(site.keyframes)} keyframes")

    def _load(self, request: LoadMapRequest) -> LoadMapResponse:
        try:
            path = parameters.file_path(request.file)
            if path is None:
                return LoadMapResponse(False, "no file is named")
            site = read_map(path)
            with self._lock:
                if self._session is not None:
                    require_camera(path, site, self._session.camera)
                self._file, self._loaded, self._session, self._complaint = path, site, None, ""
                self._lose("another map was loaded")
                self._publisher.changed()
        except InputError as error:
            return LoadMapResponse(False, one_line(str(error)))
        return LoadMapResponse(True, f"{path}: {len(site.keyframes)} keyframes")

    def _pause(self, request: SetBoolRequest) -> SetBoolResponse:
        with self._lock:
            self._mapping = not request.data
            if self._session is not None:
                self._session.set_mapping(self._mapping)
        return SetBoolResponse(True, "the map does not change any more" if request.data else "the map is built on")

    def _search(self, _request: EmptyRequest) -> EmptyResponse:
        with self._lock:
            if self._session is not None:
                self._session.search()
            self._lose("asked to search everywhere")
        return EmptyResponse()

    # Diagnostics

    def _report(self, report: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        status = self._status
        level = diagnostics.OK if status.state in GOOD else diagnostics.WARN
        name = next(name for name, value in vars(MapStatus).items() if name.isupper() and value == status.state)
        report.summary(level, f"{name.lower()}{': ' if status.why and level else ''}{status.why if level else ''}")
        if self._complaint:
            report.mergeSummary(diagnostics.ERROR, self._complaint)
        for stream, topic in ((self._views, "visual_odometry/views"), (self._poses, "fusion/left_keyframes")):
            if stream.complaint:
                report.mergeSummary(diagnostics.WARN, f"{rospy.resolve_name(topic)}: {stream.complaint}")
            report.add(f"{topic}: received", str(stream.received))
        report.add("keyframes in the map", str(status.keyframes))
        report.add("loops", str(status.loops))
        report.add("processing [ms]", f"{status.processing_ms:.1f}")
        return report
