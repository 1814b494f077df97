"""What the doctor makes of what it finds: facts in, findings out. Looking and asking is done by ``nodes.doctor``."""
