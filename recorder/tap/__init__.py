"""The role tap: listens to topics of other programs."""
