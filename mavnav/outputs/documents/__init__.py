"""The records of run.json and of the other documents, their schema, and the quantities that tables compare."""
