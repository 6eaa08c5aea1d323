"""The family of integrity monitors of S3: they take one record of code epochs, and any of them guards any drive."""
