"""Build of the package by colcon; coilcal itself is installed in the same Python with pip."""

from setuptools import setup

NAME = "coilcal_ros"
setup(
    name=NAME,
    version="0.2.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/magnet.launch.py"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="coilcal developers",
    maintainer_email="coilcal@example.org",
    description="Field of a calibrated magnet, currents for a wanted field, and reload of a new calibration.",
    license="MIT",
    entry_points={"console_scripts": [f"magnet = {NAME}.node:main"]},
)
