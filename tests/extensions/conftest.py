from command_fixtures import call, runs

__all__ = ["call", "runs"]
