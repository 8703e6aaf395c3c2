"""Files of PFS made from its data model: dots, fiducials, interference limits and a calibration model of the cobras."""

import numpy as np

PITCH = 8.0
OFFSET = -0.16, 2.26


def centers():
    """Return nominal centers of cobras 1 to 2394, from the definition of the identifiers, cobra by cobra."""
    found = []
    for field in range(3):
        turn = np.deg2rad(-120 * field)
        for module in range(14):
            for cobra in range(57):
                x = -PITCH * np.sqrt(3) / 2 * (1 + cobra % 2) - module * PITCH * np.sqrt(3)
                y = PITCH / 2 * (1 - cobra) + module * PITCH
                found.append([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)])
    return np.array(found)


def write_files(folder, limits=None):
    """Write dots, fiducials and interference limits to a folder; ``limits`` maps cobras to their limits."""
    xy = centers() + OFFSET
    rows = [f"{k},{float(x)!r},{float(y)!r},0.75" for k, (x, y) in enumerate(xy, 1)]
    (folder / "black_dots_mm-2024-11-05.csv").write_text("spotId,x,y,r\n" + "\n".join(rows) + "\n")
    angle = np.linspace(0, 2 * np.pi, 96)
    rows = [f"{k},{230 * np.cos(a):.3f},{230 * np.sin(a):.3f},0" for k, a in enumerate(angle, 1)]
    rows[57] = "58,,,1"
    (folder / "fiducial_positions_20240513.csv").write_text("fiducialId,x_mm,y_mm,flag\n" + "\n".join(rows) + "\n")
    given = {cobra: ",".join(map(str, values)) for cobra, values in (limits or {7: (5.34, 26.95, 141)}).items()}
    rows = [f"{k},{given.get(k, ',,')}" for k in range(1, 2395)]
    header = "# Cobra/fiducial interference limits\ncobra_id,theta_limit_1,theta_limit_2,max_phi_angle\n"
    (folder / "cobraInterference_20260731.csv").write_text(header + "\n".join(rows) + "\n")
    return folder


def cobra_columns(seed=0):
    """Return columns of a calibration model: real cobras differ from the nominal ones by such amounts."""
    rng = np.random.default_rng(seed)
    n = 2394
    xy = centers() + rng.normal(0, 0.05, (n, 2))
    theta = rng.uniform(0, 360, n)
    return {
        "Status": np.ones(n, dtype=int),
        "Module_Id": np.arange(n) // 57 + 1,
        "Positioner_Id": np.arange(n) % 57 + 1,
        "Global_base_pos_x": xy[:, 0],
        "Global_base_pos_y": xy[:, 1],
        "CCW_Global_base_ori_z": theta,
        "CW_Global_base_ori_z": (theta + rng.uniform(10, 25, n)) % 360,
        "Joint2_CCW_limit_angle": rng.uniform(-4, 0, n),
        "Joint2_CW_limit_angle": rng.uniform(178, 184, n),
        "Link1_Link_Length": rng.normal(2.375, 0.02, n),
        "Link2_Link_Length": rng.normal(2.375, 0.02, n),
    }


def write_cobras(path, columns):
    """Write a calibration model in XML with the elements that the data model names."""
    parts = []
    for k in range(len(columns["Status"])):
        texts = [f"<{name}>{values[k]}</{name}>" for name, values in columns.items()]
        parts.append(
            f"<ARM_DATA_CONTAINER><DATA_HEADER>{''.join(texts[:3])}</DATA_HEADER>"
            f"<KINEMATICS>{''.join(texts[3:])}</KINEMATICS></ARM_DATA_CONTAINER>"
        )
    path.write_text(f"<?xml version='1.0' encoding='UTF-8'?>\n<ARM_DATA>{''.join(parts)}</ARM_DATA>")
    return path
