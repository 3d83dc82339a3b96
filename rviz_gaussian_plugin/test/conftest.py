"""What tests share: see core_fixtures and rosplat_tools.testing."""

pytest_plugins = ["core_fixtures", "rosplat_tools.testing"]
