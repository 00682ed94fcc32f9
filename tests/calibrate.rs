//! Calibration on real and rendered boards against published results and the truth. The data are not ours to
//! distribute: the tests run where the variable DATUM_DATA names their folder.

use datum::Pixel;
use datum::calibrate::{Solution, Terms, View, read_points, solve};
use nalgebra::Vector2;
use serde_json::Value;
use std::path::{Path, PathBuf};

fn data(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("DATUM_DATA").map(|d| Path::new(&d).join(name));
    if folder.is_none() {
        eprintln!("skipped: DATUM_DATA not set");
    }
    folder
}

fn reference(folder: &Path) -> Value {
    let text = std::fs::read_to_string(folder.join("reference.json")).expect("reference.json is there");
    serde_json::from_str(&text).expect("JSON")
}

fn number(v: &Value) -> f64 {
    v.as_f64().expect("a number")
}

fn pixels(v: &Value) -> Vec<Pixel> {
    v.as_array().expect("a list").iter().map(|p| Pixel::new(number(&p[0]), number(&p[1]))).collect()
}

fn seen(pixels: Vec<Pixel>) -> Vec<(usize, Pixel)> {
    pixels.into_iter().enumerate().collect()
}

fn show(s: &Solution) {
    for (k, d) in s.devices.iter().enumerate() {
        let l = &d.lens;
        let sigma = |i: usize| s.covariance[(10 * k + i, 10 * k + i)].sqrt();
        eprintln!(
            "  device {k}: f {:.3} {:.3} c {:.3} {:.3} ± {:.3} {:.3} {:.3} {:.3}; k {:.5?}; skew {:.5}",
            l.fx,
            l.fy,
            l.cx,
            l.cy,
            sigma(0),
            sigma(1),
            sigma(2),
            sigma(3),
            l.distortion,
            d.skew
        );
    }
    eprintln!(
        "  rms {:.5?}, leave one out {:?}, baseline {:.3}",
        s.rms_px,
        s.leave_one_out_rms_px,
        s.projector_from_camera.t.norm()
    );
    for v in &s.views {
        eprintln!(
            "    {} used {} rejected {} rms {:.4?} held out {:?}",
            v.name,
            v.used,
            v.rejected,
            v.rms_px,
            v.held_out.map(|h| (h.rms_mm, h.scale))
        );
    }
}

#[test]
fn zhangs_points_give_his_published_parameters() {
    let Some(folder) = data("zhang1998") else { return };
    let model = read_points(&folder.join("Model.txt")).expect("points");
    let view = |k: usize| View {
        name: format!("data{k}"),
        seen: [seen(read_points(&folder.join(format!("data{k}.txt"))).expect("points")), Vec::new()],
    };
    let views: Vec<View> = (1..=5).map(view).collect();
    let got = solve(&model, &views, [Some((640, 480)), None], Terms::Zhang).expect("five tilted views");
    show(&got);
}

#[test]
fn opencvs_corners() {
    let Some(folder) = data("chessboard-left") else { return };
    let reference = reference(&folder);
    let board: Vec<_> = (0..54).map(|i| Vector2::new(f64::from(i % 9), f64::from(i / 9))).collect();
    let view = |(name, v): (&String, &Value)| View { name: name.clone(), seen: [seen(pixels(v)), Vec::new()] };
    let views: Vec<View> = reference["corners"].as_object().expect("a table").iter().map(view).collect();
    let got = solve(&board, &views, [Some((640, 480)), None], Terms::Chosen).expect("13 views");
    show(&got);
}

#[test]
fn slstudio_corners() {
    let Some(folder) = data("slstudio") else { return };
    let reference = reference(&folder);
    let board: Vec<_> = (0..117).map(|i| Vector2::new(f64::from(i % 13), f64::from(i / 13)) * 10.0).collect();
    let view = |id: &u32| {
        let v = &reference["corners"][id.to_string()];
        View { name: format!("board-{id}"), seen: [seen(pixels(&v["cam"])), seen(pixels(&v["proj"]))] }
    };
    let views: Vec<View> = [1, 3, 4, 5, 6].iter().map(view).collect();
    let got = solve(&board, &views, [Some((1688, 1352)), Some((1824, 1140))], Terms::Chosen).expect("5 views");
    show(&got);
}

#[test]
fn chess_truth_corners() {
    let Some(folder) = data("station-boards/chess") else { return };
    let truth = datum::Calibration::read(&folder.join("calibration-truth.toml")).expect("truth");
    let board: datum::calibrate::Board = "chessboard:11x8:35".parse().expect("legal");
    let points = board.points();
    let mut views = Vec::new();
    let mut sq = (0.0, 0.0, Vector2::zeros());
    for k in 0..10 {
        let folder = folder.join(format!("board_chess_cal_{k:02}"));
        let text = std::fs::read_to_string(folder.join("truth.json")).expect("truth.json");
        let t: Value = serde_json::from_str(&text).expect("JSON");
        let m = |i: usize, j: usize| number(&t["camera_from_object"][i][j]);
        let r = nalgebra::Matrix3::from_fn(m);
        let tr = nalgebra::Vector3::from_fn(|i, _| m(i, 3));
        let in_camera: Vec<_> = points.iter().map(|p| r * p.push(0.0) + tr).collect();
        let cam: Vec<_> = in_camera.iter().map(|p| truth.rig.camera.project(p).expect("front")).enumerate().collect();
        let capture = datum::Capture::open(&folder).expect("capture");
        let lit = datum::calibrate::Lit::read(&capture, &board, &cam).expect("lit");
        let proj = lit.projector(&board, &cam);
        for &(i, at) in &proj {
            let p = truth.rig.projector_from_camera * datum::Point3::new(in_camera[i]);
            let e = at - truth.rig.projector.project(&p.xyz).expect("front");
            sq = (sq.0 + e.norm_squared(), sq.1 + 1.0, sq.2 + e);
        }
        views.push(View { name: format!("{k}"), seen: [cam, proj] });
    }
    eprintln!("projector px rms {:.4} mean {:?} n {}", (sq.0 / sq.1 as f64).sqrt(), sq.2 / sq.1, sq.1);
    let mut noise = 1u64;
    for v in &mut views {
        for s in &mut v.seen[0] {
            for c in 0..2 {
                let mut g = 0.0;
                for _ in 0..12 {
                    noise = noise.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    g += (noise >> 11) as f64 / (1u64 << 53) as f64;
                }
                s.1[c] += 0.02 * (g - 6.0);
            }
        }
    }
    let got = solve(&points, &views, [Some((648, 486)), Some((1280, 800))], Terms::Chosen).expect("10 views");
    show(&got);
}

#[test]
fn slstudio_own_phase() {
    let Some(folder) = data("slstudio") else { return };
    let reference = reference(&folder);
    let board: datum::calibrate::Board = "chessboard:13x9:10".parse().expect("legal");
    let points = board.points();
    let view = |id: &u32| {
        let v = &reference["corners"][id.to_string()];
        let cam = seen(pixels(&v["cam"]));
        let capture = datum::Capture::open(&folder.join(format!("board-{id}"))).expect("capture");
        let lit = datum::calibrate::Lit::read(&capture, &board, &cam).expect("lit");
        let proj = lit.projector(&board, &cam);
        View { name: format!("board-{id}"), seen: [cam, proj] }
    };
    let views: Vec<View> = [1, 3, 4, 5, 6].iter().map(view).collect();
    let got = solve(&points, &views, [Some((1688, 1352)), Some((1824, 1140))], Terms::Chosen).expect("5 views");
    show(&got);
}
