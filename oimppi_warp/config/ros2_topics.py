"""Names of ROS 2 topics and frames: what the plant ``ros2`` uses by default, and what is written to bags.

Those of the arm and the object are the ones that the paper's authors use in their laboratory, in
NikolaRaicevic2001/Object-Informed-Manipulation-MJX, ``oim/worlds/real3d/interface.py``.
"""

JOINT_STATES = "/joint_states"
"""sensor_msgs/JointState: position and velocity of the joints."""
NOMINAL_COMMANDS = "/velocity_controller/commands_nominal"
"""std_msgs/Float64MultiArray: joint velocities as planned; in the authors' laboratory a safety filter is behind it."""
FILTERED_COMMANDS = "/velocity_controller/commands"
"""std_msgs/Float64MultiArray: joint velocities after the safety filter."""
OBJECT_POSE = "/object_pose"
"""geometry_msgs/PoseStamped: the object's pose."""
PLAN = "/oimppi/plan"
"""nav_msgs/Path: the object's planned poses."""
REFERENCE = "/oimppi/reference"
"""geometry_msgs/PoseStamped: the pose of the object that the robot level follows."""
MARKERS = "/oimppi/markers"
"""visualization_msgs/MarkerArray: robot, object, obstacles and goal."""
CLOCK = "/clock"
"""rosgraph_msgs/Clock: time of a simulation."""
TF, TF_STATIC = "/tf", "/tf_static"
"""tf2_msgs/TFMessage: transforms between frames."""

WORLD_FRAME = "world"
"""Frame of the scene."""
OBJECT_FRAME = "fp_object_pose"
"""Frame of the object, as FoundationPose names it there."""
