"""A SLAM back end and a robot, emulated from a scene."""
