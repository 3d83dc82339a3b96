"""Installs rosplat_tools, and its executables for `ros2 run`."""

from setuptools import find_packages, setup

EXECUTABLES = [
    "convert",
    "demo_sensors",
    "follow",
    "generate",
    "inspect",
    "ply_publisher",
    "slam_emulator",
    "stream_publisher",
]

setup(
    name="rosplat_tools",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/rosplat_tools"]),
        ("share/rosplat_tools", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    # colcon test finds the tests of a Python package by this.
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="ROSplat developers",
    maintainer_email="dev@rosplat.org",
    description="Publishes maps of 3D Gaussians from scene files and SLAM back ends.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [f"{name} = rosplat_tools.commands:{name}" for name in EXECUTABLES]
    },
)
