#include "arc.h"

enum { ARC_FROM_MAX = 64, ARC_STEPS_MAX = 10000 };

bool arc_make(arc *a, const planner_settings *set, const motion *m, double v, double w, int steps) {
    const double dt = set->sim_time / steps, faster = set->acc_lim_x * dt, turn_faster = set->acc_lim_theta * dt;
    double x = m->x, y = m->y, th = m->th, speed = m->v, rate = m->w;
    const double large = fmax(fmax(fabs(x), fabs(y)), fmax(fabs(speed), fmax(fabs(rate), fabs(th))));
    if (!(large < 5e3) || steps > ARC_STEPS_MAX) return false;
    int i = 0;
    for (; i < steps - 1 && (speed != v || rate != w); ++i) {
        double s, c;
        if (i == ARC_FROM_MAX) return false;
        arc_sincos(th, &s, &c);
        speed = towards(v, speed, faster);
        rate = towards(w, rate, turn_faster);
        x += speed * c * dt;
        y += speed * s * dt;
        th += rate * dt;
    }
    const double turn = w * dt;
    double s = 0, c = 0;
    if (!(fabs(turn) < 1)) return false;
    if (fabs(turn) > 1e-9) arc_sincos(turn / 2, &s, &c);
    *a = (arc){v, w, x, y, th, turn, v * dt, s != 0 ? 1 / s : 0, dt, steps, i};
    return true;
}

static arc_pose early(const arc *a, const planner_settings *set, const motion *m, int step) {
    double x = m->x, y = m->y, th = m->th, speed = m->v, rate = m->w;
    for (int i = 0; i < step; ++i) {
        double s, c;
        arc_sincos(th, &s, &c);
        speed = towards(a->v, speed, set->acc_lim_x * a->dt);
        rate = towards(a->w, rate, set->acc_lim_theta * a->dt);
        x += speed * c * a->dt;
        y += speed * s * a->dt;
        th += rate * a->dt;
    }
    return (arc_pose){x, y, th};
}

// The sum of cos(th + k turn) for k < n is sin(n turn / 2) / sin(turn / 2) cos(th + (n - 1) turn / 2).
arc_pose arc_at(const arc *a, const planner_settings *set, const motion *m, int step) {
    if (step < a->from) return early(a, set, m, step);
    const double n = step - a->from;
    double s, c, half, unused;
    arc_sincos(a->th + (n - 1) * a->turn * 0.5, &s, &c);
    double length = n * a->pace;
    if (a->per_half != 0) {
        arc_sincos(n * a->turn * 0.5, &half, &unused);
        length = a->pace * half * a->per_half;
    }
    return (arc_pose){a->x + length * c, a->y + length * s, a->th + n * a->turn};
}
