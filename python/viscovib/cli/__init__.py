"""The commands of ``viscovib``."""
