"""Commands of ``viscovib``."""
