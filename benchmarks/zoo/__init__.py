"""Files as loggers write them, read and compared with the numbers they were made from."""
