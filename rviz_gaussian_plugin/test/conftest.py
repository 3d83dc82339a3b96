"""What tests share: see rosplat_tools.testing."""

pytest_plugins = ["rosplat_tools.testing"]
