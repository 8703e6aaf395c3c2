"""Write files of SDSS-V with invented values: calibrations of the focal plane system, and configurations."""

import csv
import gzip

import numpy as np

import rfpsurvey as rs

HOLES = ("R-1C13", "R-1C14", "R0C13", "R0C15", "R+1C13", "R+1C14", "R+2C13")
FIDUCIALS = ("R-2C12", "F1")
ROBOT_COLUMNS = (
    *("alphaArmLen", "metX", "metY", "apX", "apY", "bossX", "bossY"),
    *("alphaOffset", "betaOffset", "dx", "dy"),
)
MODEL = """# waveCat: Boss, Apogee, or GFA
direction,site,waveCat,R,b,c0,c1,c2,c3,c4
focal,{0},Boss,9208,8432,1.3,6.1e-03,6.5e-04,2.6e-05,-2.2e-05
focal,{0},Apogee,8939,8163,1.4,6.2e-03,7.2e-04,-3.2e-06,-1.6e-05
field,{0},Boss,9208,8432,0.7,-1.7e-03,-9.2e-05,1.8e-06,6.4e-07
field,{0},Apogee,8939,8163,0.7,-1.5e-03,-8.6e-05,3.1e-06,3.1e-07
"""

MODEL_LCO = """direction,site,waveCat,R,b,c0,c1,c2,c3,c4
focal,LCO,Boss,9940,8432,1.9,1.3e-02,1.1e-04,5.8e-05,0
focal,LCO,Apogee,8900,8163,2.1,1.4e-02,1.3e-04,7.0e-05,0
"""


def write_csv(path, rows):
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def robot_values(seed=1):
    """Return the columns of the robots by hole."""
    rng = np.random.default_rng(seed)
    middle = (7.4, 14.3, 0.0, 14.965, 0.376, 14.965, -0.376, 0.0, 0.0, 0.15, -0.15)
    spread = (0.05, 0.05, 0.0, 0.05, 0.01, 0.05, 0.01, 1.5, 0.8, 0.1, 0.1)
    return {hole: dict(zip(ROBOT_COLUMNS, rng.normal(middle, spread).tolist(), strict=True)) for hole in HOLES}


def calibration(folder, *, site="APO", index="", **changes):
    """Write the files of a calibration; ``changes`` maps the names of files to functions that change the rows."""
    folder.mkdir(exist_ok=True)
    plane = rs.Instrument.preset("sdss_apo").focal_plane
    centers = dict(zip(plane.id.tolist(), plane.xy.value.tolist(), strict=True))
    values = robot_values()
    common = {"site": site, "wokID": "flatNominal"}
    vectors = {"ix": 0, "iy": -1, "iz": 0, "jx": 1, "jy": 0, "jz": 0, "kx": 0, "ky": 0, "kz": 1}
    files = {
        "positionerTable": [
            {index: k, "site": site, "holeID": hole, "positionerID": 100 + k, "wokID": "flatNominal", **values[hole]}
            for k, hole in enumerate(reversed(HOLES))
        ],
        "wokCoords": [
            {
                **{index: k, **common, "holeID": hole, "holeType": "Boss" if hole == HOLES[0] else "ApogeeBoss"},
                **{"xWok": centers[hole][0], "yWok": centers[hole][1], "zWok": 0, **vectors},
            }
            for k, hole in enumerate((*HOLES, "R+5C5"))
        ],
        "fiberAssignments": [
            {
                **{index: k, "site": site, "holeID": hole, "Device": "Positioner", "BOSSFiber": 39 + k},
                **{"APOGEEFiber": "" if hole == HOLES[0] else 148 + k},
            }
            for k, hole in enumerate(HOLES)
        ]
        + [{index: 9, "site": site, "holeID": "R-2C12", "Device": "Fiducial", "BOSSFiber": "", "APOGEEFiber": ""}],
        "fiducialCoords": [
            {index: k, "site": site, "holeID": hole, "id": f"F{k}", "xWok": x, "yWok": -45.0}
            for k, (hole, x) in enumerate(zip(FIDUCIALS, (-10.5, 320.0), strict=True))
        ],
        "wokOrientation": [{"site": site, "x": 0, "y": 0, "z": -919.4, "xTilt": 0, "yTilt": 0}],
    }
    for name, rows in files.items():
        write_csv(folder / f"{name}.csv", changes[name](rows) if name in changes else rows)
    (folder / "focalPlaneModel.csv").write_text(MODEL_LCO if site == "LCO" else MODEL.format(site))
    return folder


def formula(values, center, alpha, beta, fiber):
    """Return the position of a fiber (mm) as published, for a robot of `robot_values`."""
    a, b = np.deg2rad(alpha + values["alphaOffset"]), np.deg2rad(beta + values["betaOffset"])
    fx, fy = values[f"{fiber}X"], values[f"{fiber}Y"]
    tx = values["alphaArmLen"] * np.cos(a) + fx * np.cos(a + b) - fy * np.sin(a + b)
    ty = values["alphaArmLen"] * np.sin(a) + fx * np.sin(a + b) + fy * np.cos(a + b)
    return center[0] + ty + values["dy"], center[1] - tx - values["dx"]


HEADER = """#%yanny
#
# invented
#
configuration_id 7
observatory {site}
epoch 2460427
raCen 120.0
decCen 30.0
pa {pa}

typedef enum {{
    BOSS,
    APOGEE,
    METROLOGY,
    NONE
}} FIBERTYPE;

typedef struct {{
    short positionerId;
    char holeId[28];
    FIBERTYPE fiberType;
    short assigned;
    short valid;
{positions}
    float alpha;
    float beta;
    double racat;
    double deccat;
    float pmra;
    float mag[2];
    long catalogid;
    char category[40];
}} FIBERMAP;

"""


def configuration(path, *, pa=60.0, site="APO", wok=True, change=lambda text: text):
    """Write a confSummary file with invented values for all fibers of the robots; ``change`` edits its text."""
    plane = rs.Instrument.preset("sdss_apo").focal_plane
    centers = dict(zip(plane.id.tolist(), plane.xy.value.tolist(), strict=True))
    names = ("xwok", "ywok", "xFocal", "yFocal") if wok else ("xFocal", "yFocal")
    text = HEADER.format(site=site, pa=pa, positions="\n".join(f"    double {name};" for name in names))
    c, s = np.cos(np.deg2rad(pa)), np.sin(np.deg2rad(pa))
    for k, (hole, values) in enumerate(robot_values().items()):
        alpha, beta = round(40.0 * k + 3, 3), round(60.0 + 10 * k, 3)
        for fiber, place in (("APOGEE", "ap"), ("BOSS", "boss"), ("METROLOGY", "met")):
            x, y = formula(values, centers[hole], alpha, beta, place)
            xy = (f"{x} {y} " if wok else "") + f"{c * x + s * y} {-s * x + c * y}"
            taken = fiber == ("APOGEE" if k == 2 else "BOSS") and k != 4
            sky = f"{120 + 0.01 * k} {30 - 0.01 * k} 1.5" if taken else "-999.0 -999.0 -999.0"
            kind = (
                ("sky_boss", "standard_boss", "sky_apogee", "science", "", "science", "science")[k] if taken else '""'
            )
            name = 27021597909966377 + k if taken else -999
            text += (
                f"FIBERMAP {k} {hole} {fiber} {int(taken)} 1 {xy} {alpha} {beta} {sky} {{-999.0 nan}} {name} {kind}\n"
            )
    text = change(text)
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    return path
