"""The TOML file of an instrument that is no preset."""

MOONS_LIKE = 'plate_scale = { value = 60.0, unit = "um / arcsec" }'


def description(arms, clearance, layout, optics=MOONS_LIKE, positioner="", end=""):
    """Return the description of an instrument ``mine`` whose values are assumed; lengths are in mm."""
    lengths = zip(("central_arm", "eccentric_arm", "clearance"), (*arms, clearance), strict=True)
    lines = "\n".join(f'{name} = {{ value = {length}, unit = "mm" }}' for name, length in lengths)
    head = f'schema = 1\nname = "mine"\nstatus = "assumed"\nsource = "a test"\n[positioner]\n{lines}\n{positioner}\n'
    return f"{head}[layout]\n{layout}\n[optics]\n{optics}\n{end}"


def hexagon(rings, pitch):
    """Return the entries of a hexagonal layout; the pitch is in mm."""
    return f'rings = {{ value = {rings} }}\npitch = {{ value = {pitch}, unit = "mm" }}'
