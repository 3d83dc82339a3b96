"""Measures ROSplat on the machine it runs on; a file for each subject, `command` runs them.

Subjects that need ROS 2 import it when they begin, so sorting and drawing can be measured without.
"""
