"""The build of the ROS 2 package (ament_python)."""

from setuptools import setup

NAME = "revisit_bridge"

setup(
    name=NAME,
    version="0.2.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/bridge.launch.py"]),
        (f"share/{NAME}/config", ["config/bridge.yaml", "config/bridge.rviz"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="Revisit maintainers",
    maintainer_email="maintainers@revisit.invalid",
    description="Streams LiDAR scans to Revisit and publishes its loop closures and corrections.",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"bridge = {NAME}.node:main", f"lifecycle_bridge = {NAME}.lifecycle_node:main"]},
)
