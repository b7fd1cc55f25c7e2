"""The C of `c_header`: `string.Template`s, `$name` what all names begin with."""

COMMENT = """\
#ifndef ${NAME}_COMPENSATION_H
#define ${NAME}_COMPENSATION_H

/*
$about
 */

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math removes the tests for readings that are no numbers; compile without it"
#endif
"""

FUNCTION_NOTES = {
    "backlash": (
        "{name}_backlash(phi1, phi2): backlash in rad of the driven gear and its slope by phi1;"
        " negative where the map says that the pair binds.",
    ),
    "shift": (
        "{name}_shift(phi1, phi2, margin_mm): axial displacement of the driven gear towards the"
        " thick end of the driving one that leaves margin_mm of displacement open, mm, and its"
        " slope by phi1 in mm/rad. Never below 0; where the margin leaves nothing to close both are"
        " 0. A margin that is negative or no number makes it {NAME}_UNKNOWN.",
        "The slope is along the motion: times the driving speed in rad/s it is the speed of the"
        " actuator in mm/s.",
    ),
}

ARITHMETIC = """\
enum { ${NAME}_KNOWN = 0, ${NAME}_UNKNOWN = 1 };

/* Next whole number, for less than 2^31. */
static inline double ${name}_nearest_(double x)
{
    return (double)(long)(x < 0.0 ? x - 0.5 : x + 0.5);
}

/* Sine and cosine, for angles up to 1e5 rad, within 1e-15. */
static inline void ${name}_sincos_(double x, double *sine, double *cosine)
{
    const double quarters = ${name}_nearest_(x * 0.6366197723675814);
    const double r = x - quarters * 1.5707963267923333 - quarters * 2.563344151594519e-12;
    const double t = r * r;
    const double s = r + r * t * (-0.16666666666666666 + t * (0.008333333333330948
        + t * (-0.00019841269836758574 + t * (2.755731610255244e-06
        + t * (-2.5051131845003624e-08 + t * 1.5918129294866608e-10)))));
    const double c = 1.0 - 0.5 * t + t * t * (0.041666666666666664
        + t * (-0.0013888888888887398 + t * (2.480158729876569e-05
        + t * (-2.7557317271729793e-07 + t * (2.08761462684032e-09
        + t * -1.1382632425521717e-11)))));
    switch ((int)((long)quarters & 3)) {
    case 0: *sine = s; *cosine = c; break;
    case 1: *sine = c; *cosine = -s; break;
    case 2: *sine = -s; *cosine = -c; break;
    default: *sine = -c; *cosine = s; break;
    }
}

/* An angle without its whole turns; 2 pi in three parts, the first two short. */
static inline double ${name}_within_turn_(double x)
{
    const double turns = ${name}_nearest_(x * 0.15915494309189535);
    return x - turns * $turn_0 - turns * $turn_1 - turns * $turn_2;
}
"""

BACKLASH = """\
struct ${name}_gap {
    double backlash_rad;
    double slope;
    int status;
};

static inline struct ${name}_gap ${name}_backlash(double driving_rad, double driven_rad)
{
    static const double driving_orders[$driving_count] = {
$driving_orders
    };
    static const double driven_orders[$driven_count] = {
$driven_orders
    };
    /* Of every harmonic: places of its orders above, then cosine and sine in rad. */
    static const $place_type places[$terms][2] = {
$places
    };
    static const double waves[$terms][2] = {
$waves
    };
    struct ${name}_gap found = { 0.0, 0.0, ${NAME}_UNKNOWN };
    double sine1[$driving_count], cosine1[$driving_count];
    double sine2[$driven_count], cosine2[$driven_count];
    double phi1, turn, apart, ideal, value, slope;
    int k;

    if (!(driving_rad >= -1e9 && driving_rad <= 1e9 && driven_rad >= -1e9 && driven_rad <= 1e9))
        return found;
    /* The driven angle without its transmission error: one of those the pair can have. */
    phi1 = ${name}_within_turn_(driving_rad);
    apart = ${name}_within_turn_(driven_rad) - $ratio * phi1 - ($offset);
    turn = ${name}_nearest_(apart / $spacing);
    apart -= turn * $spacing;
    if (!(apart >= -$tolerance && apart <= $tolerance))
        return found;
    ideal = ${name}_within_turn_($ratio * phi1 + turn * $spacing);

    for (k = 0; k < $driving_count; ++k)
        ${name}_sincos_(driving_orders[k] * phi1, &sine1[k], &cosine1[k]);
    for (k = 0; k < $driven_count; ++k)
        ${name}_sincos_(driven_orders[k] * ideal, &sine2[k], &cosine2[k]);
    value = $constant;
    slope = 0.0;
    for (k = 0; k < $terms; ++k) {
        const int p = places[k][0], q = places[k][1];
        const double sine = sine1[p] * cosine2[q] + cosine1[p] * sine2[q];
        const double cosine = cosine1[p] * cosine2[q] - sine1[p] * sine2[q];
        value += waves[k][0] * cosine + waves[k][1] * sine;
        slope += (driving_orders[p] + $ratio * driven_orders[q])
            * (waves[k][1] * cosine - waves[k][0] * sine);
    }
    found.backlash_rad = value;
    found.slope = slope;
    found.status = ${NAME}_KNOWN;
    return found;
}
"""

SHIFT = """\
struct ${name}_displacement {
    double shift_mm;
    double slope_mm_per_rad;
    int status;
};

static inline struct ${name}_displacement ${name}_shift(
    double driving_rad, double driven_rad, double margin_mm)
{
    const struct ${name}_gap gap = ${name}_backlash(driving_rad, driven_rad);
    struct ${name}_displacement found = { 0.0, 0.0, ${NAME}_UNKNOWN };

    if (gap.status != ${NAME}_KNOWN || !(margin_mm >= 0.0 && margin_mm <= 1e9))
        return found;
    found.status = ${NAME}_KNOWN;
    if (gap.backlash_rad > margin_mm * $closing) {
        found.shift_mm = gap.backlash_rad / $closing - margin_mm;
        found.slope_mm_per_rad = gap.slope / $closing;
    }
    return found;
}
"""

READING = """\
/* The $shaft angle in rad from a reading of its encoder in $unit. */
static inline double ${name}_${shaft}_rad(double reading)
{
    return $size * (reading - ($origin));
}
"""
