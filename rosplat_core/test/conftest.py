"""What tests share: see core_fixtures."""

pytest_plugins = ["core_fixtures"]
