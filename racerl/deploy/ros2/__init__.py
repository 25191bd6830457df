"""A ROS 2 node that lets a policy drive an F1TENTH / RoboRacer car."""
