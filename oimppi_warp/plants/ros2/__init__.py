"""ROS 2: a plant that moves an arm through topics, and a simulated laboratory on the same topics to try it with."""
