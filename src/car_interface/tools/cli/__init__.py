"""The commands for recordings and tables: ``car-interface COMMAND``."""
