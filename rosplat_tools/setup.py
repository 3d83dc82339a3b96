"""Installs rosplat_tools, and its executables for `ros2 run`."""

from setuptools import find_packages, setup

EXECUTABLES = [
    "bench",
    "convert",
    "demo",
    "demo_sensors",
    "generate",
    "inspect",
    "lab",
    "ply_publisher",
    "render",
    "slam_emulator",
    "viewer",
]

setup(
    name="rosplat_tools",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"rosplat_tools.lab": ["report.html"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/rosplat_tools"]),
        ("share/rosplat_tools", ["package.xml"]),
        ("share/rosplat_tools/config", ["config/rosplat.rviz", "config/sensors.rviz"]),
        ("share/rosplat_tools/launch", ["launch/fast_dds.launch.py", "launch/view.launch.xml"]),
    ],
    install_requires=["setuptools"],
    # colcon test finds the tests of a Python package by this.
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="ROSplat developers",
    maintainer_email="dev@rosplat.org",
    description="Publishes maps of 3D Gaussians, draws them, and studies the pictures.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [f"{name} = rosplat_tools.{name}:main" for name in EXECUTABLES]
    },
)
