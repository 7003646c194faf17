"""Messages: from the bytes of a message to a record, and back."""
