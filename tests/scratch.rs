use datum::calibrate::*;
#[test]
fn scratch() {
    let board: Board = std::env::var("BOARD").unwrap().parse().unwrap();
    let mut views = Vec::new();
    let mut sizes = [None, None];
    for f in std::env::var("CAPS").unwrap().split_whitespace() {
        let c = datum::Capture::open(std::path::Path::new(f)).unwrap();
        let s = target::find(&mean(&c).unwrap(), &board).unwrap();
        let cam: Vec<_> = s.marks.iter().enumerate().filter_map(|(k, m)| Some((k, m.as_ref()?.at))).collect();
        let lit = Lit::read(&c, &board, &cam).unwrap().projector(&board, &cam);
        sizes = [Some((c.camera.width, c.camera.height)), Some((c.projector.width, c.projector.height))];
        eprintln!("{f} {} {}", cam.len(), lit.len());
        views.push(View { name: f.rsplit('/').next().unwrap().into(), seen: [cam, lit] });
    }
    for terms in [Terms::All, Terms::Chosen] {
        let s = solve(&board.points(), &views, sizes, terms).unwrap();
        for (k, d) in s.devices.iter().enumerate() {
            let l = &d.lens;
            let g = |i: usize| s.covariance[(10 * k + i, 10 * k + i)].sqrt();
            eprintln!(
                "{terms:?} {k}: f {:.3} {:.3} c {:.3} {:.3} ± {:.3} {:.3} {:.3} {:.3}; k {:.5?} ± {:.5} {:.5} {:.5} {:.5} {:.5}",
                l.fx,
                l.fy,
                l.cx,
                l.cy,
                g(0),
                g(1),
                g(2),
                g(3),
                l.distortion,
                g(4),
                g(5),
                g(6),
                g(7),
                g(8)
            );
        }
        eprintln!("rms {:?} loo {:?} t {:?}", s.rms_px, s.leave_one_out_rms_px, s.projector_from_camera.t);
        for v in &s.views {
            eprintln!(
                "  {} {} rej {} {:?} {:?}",
                v.name,
                v.used,
                v.rejected,
                v.rms_px,
                v.held_out.map(|h| (h.scale, h.rms_mm))
            );
        }
    }
}
#[test]
fn time20() {
    use nalgebra::*;
    let board: Vec<_> = (0..117).map(|i| Vector2::new((i % 13) as f64, (i / 13) as f64) * 30.0).collect();
    let lens = datum::Lens {
        width: 2592,
        height: 1944,
        fx: 2721.6,
        fy: 2721.6,
        cx: 1295.5,
        cy: 971.5,
        distortion: [-0.12, 0.08, 4e-4, -3e-4, 0.01],
    };
    let mut s = 1u64;
    let mut g = || {
        let mut t = 0.0;
        for _ in 0..12 {
            s = s.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            t += (s >> 11) as f64 / (1u64 << 53) as f64;
        }
        t - 6.0
    };
    let views: Vec<View> = (0..20)
        .map(|k| {
            let r = Rotation3::new(Vector3::new(g(), g(), g()) * 0.35);
            let t = Vector3::new(-180.0 + g() * 40.0, -120.0 + g() * 30.0, 750.0 + g() * 60.0);
            let seen = board
                .iter()
                .map(|p| lens.project(&(r * p.push(0.0) + t)).unwrap() + 0.05 * Vector2::new(g(), g()))
                .enumerate()
                .collect();
            View { name: k.to_string(), seen: [seen, vec![]] }
        })
        .collect();
    for terms in [Terms::All, Terms::Chosen] {
        let mut best = 1e9f64;
        for _ in 0..20 {
            let t = std::time::Instant::now();
            let got = solve(&board, &views, [Some((2592, 1944)), None], terms).unwrap();
            best = best.min(t.elapsed().as_secs_f64() * 1e3);
            assert!(got.rms_px[0] > 0.0);
        }
        eprintln!("{terms:?} {best:.2} ms");
    }
}
