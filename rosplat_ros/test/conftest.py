"""What tests share: see core_fixtures and ros_fixtures."""

pytest_plugins = ["core_fixtures", "ros_fixtures"]
