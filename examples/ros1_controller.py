"""SEAN 2.0's tutorial controller: as a node of ROS 1, and as a policy inside sean_jax, with the same commands.

The controller turns towards the goal and drives faster when it is far away; it sees neither people nor walls.

    python3 examples/ros1_controller.py                       # with ROS_MASTER_URI set; needs rospy alone
    sean run --policy ros1: --episodes 4                      # in another terminal: drives the node's robot
    sean run --policy examples/ros1_controller.py:inside --episodes 4

Source of the law: SEAN 2.0, tutorial_controller.py.
"""

import math
import sys
import threading

JUMP = 0.1  # m between two states: the robot was placed at another start, and has another goal
WAIT = 1.0  # s, for the goal that belongs to a start


def command(x: float, y: float, z: float, w: float, goal_x: float, goal_y: float) -> tuple[float, float]:
    """Speed [m/s] and turn rate [rad/s] from the robot's place [m], its quaternion and the goal [m]."""
    error = math.atan2(goal_y - y, goal_x - x) - 2.0 * math.atan2(z, w)
    error = math.atan2(math.sin(error), math.cos(error))
    distance = math.hypot(goal_x - x, goal_y - y)
    return min(max(0.2 * distance, 0.1), 0.5), 0.5 * error


def inside(scenario, state, key):
    """The controller as a policy of sean_jax, which sees what the node sees."""
    import jax
    import numpy as np

    from sean_jax.ros.messages import pose

    def on_host(position, heading, goal):
        place, goal = pose(np.asarray(position), np.asarray(heading)), np.asarray(goal)
        at, turn = place["position"], place["orientation"]
        return np.asarray(command(at["x"], at["y"], turn["z"], turn["w"], float(goal[0]), float(goal[1])), goal.dtype)

    robot, goal = state.robot, state.task.goal
    result = jax.ShapeDtypeStruct((2,), goal.dtype)
    return jax.pure_callback(on_host, result, robot.position, robot.heading, goal, vmap_method="sequential")


def main() -> None:
    """Answer each odometry with a command, until the node ends."""
    try:
        import rospy
    except ImportError:
        sys.path.append("/usr/lib/python3/dist-packages")  # of Debian, for another Python of the same version
        import rospy
    from geometry_msgs.msg import PoseStamped, Twist
    from nav_msgs.msg import Odometry

    rospy.init_node("tutorial_controller")
    publisher = rospy.Publisher("/cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
    changed, goal, last = threading.Condition(), None, None

    def receive_goal(message):
        nonlocal goal
        with changed:
            goal = message
            changed.notify_all()

    def receive_odometry(message):
        nonlocal last
        at, turn = message.pose.pose.position, message.pose.pose.orientation
        if last is None or math.hypot(at.x - last.x, at.y - last.y) > JUMP:  # topics may overtake each other
            with changed:
                changed.wait_for(lambda: goal is not None and goal.header.stamp >= message.header.stamp, WAIT)
        last = at
        if goal is not None:
            twist = Twist()
            there = goal.pose.position
            twist.linear.x, twist.angular.z = command(at.x, at.y, turn.z, turn.w, there.x, there.y)
            publisher.publish(twist)

    rospy.Subscriber("/goal", PoseStamped, receive_goal, tcp_nodelay=True)
    rospy.Subscriber("/odom", Odometry, receive_odometry, tcp_nodelay=True)
    rospy.spin()


if __name__ == "__main__":
    main()
