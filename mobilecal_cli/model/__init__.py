"""The data types that the stages exchange: frozen dataclasses with checked shapes and read-only arrays."""

from mobilecal_cli.model.arrays import BoolArray, FloatArray, GrayImage, IntArray
from mobilecal_cli.model.calibration import NINE, WHEEL_WORDS, CalibratedRobot, Knowledge, Parameters
from mobilecal_cli.model.findings import (
    AtWork,
    BetweenLogs,
    Budget,
    Diagnosis,
    EstimatedConstant,
    Evidence,
    Jump,
    ScaleCheck,
    Suggestion,
)
from mobilecal_cli.model.inspection import (
    BoardView,
    FleetRow,
    Inspection,
    JointRange,
    Lack,
    MotionView,
    Parts,
    TopicView,
)
from mobilecal_cli.model.observations import (
    Corners,
    Extraction,
    LogSource,
    Observation,
    SensorMotion,
    Snapshot,
    WheelTrack,
)
from mobilecal_cli.model.rig import (
    FACTORS,
    SIDES,
    AssumedOdometry,
    Board,
    Camera,
    CameraInfo,
    CameraRig,
    Distortion,
    FixedLink,
    HeadChain,
    JointField,
    JointLink,
    JointTransform,
    KnownNoise,
    LensCorrection,
    Markers,
    Nominal,
    Rig,
    Side,
    Sources,
    StereoLayout,
    WheelGeometry,
    WheelSource,
    camera_words,
)
from mobilecal_cli.model.robot_description import (
    CAMERA_INFO,
    CAMERA_INFO_CHANGES,
    IMAGES,
    JOINT_STATE,
    ODOMETRY,
    STRING,
    TRANSFORMS,
    NumberField,
    RobotDescription,
    TopicInfo,
)
from mobilecal_cli.model.signals import (
    NO_IMAGES,
    PictureIndex,
    Rejection,
    Shot,
    Signals,
    Station,
    Track,
    sampled,
)
from mobilecal_cli.model.solution import (
    EXACT,
    Drift,
    Evaluation,
    LinearEstimate,
    Method,
    Noise,
    NoiseLevels,
    Outlier,
    Provenance,
    Refinement,
    Residuals,
    Setting,
    Solution,
    Uncertainty,
)
from mobilecal_cli.model.text import listed
