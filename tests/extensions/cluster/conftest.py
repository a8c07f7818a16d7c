from campaigns import runs

__all__ = ["runs"]
