"""Detection of persons in a cloud: finder, votes, second stage, odds."""
