// SPDX-License-Identifier: GPL-2.0
/*
 * A PWM chip without pins, as the one that dims a station's light bars: what is
 * asked of it can be read from /sys/devices/platform/datum-pwm/state, a line per
 * channel: duty cycle (ns), period (ns), whether it runs.
 */
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/pwm.h>
#include <linux/sysfs.h>

#define CHANNELS 2

static struct pwm_chip chip;

static int apply(struct pwm_chip *c, struct pwm_device *pwm, const struct pwm_state *state)
{
	if (state->period < 1000 || state->polarity != PWM_POLARITY_NORMAL)
		return -EINVAL;
	return 0; /* the core keeps what was asked for, also when nobody holds the channel any more */
}

static const struct pwm_ops ops = {
	.owner = THIS_MODULE,
	.apply = apply,
};

static ssize_t state_show(struct device *dev, struct device_attribute *attr, char *out)
{
	int k, n = 0;

	for (k = 0; k < CHANNELS; k++) {
		struct pwm_state *s = &chip.pwms[k].state;

		n += sysfs_emit_at(out, n, "%llu %llu %d\n", s->duty_cycle, s->period, s->enabled);
	}
	return n;
}
static DEVICE_ATTR_RO(state);

static int probe(struct platform_device *pdev)
{
	int err;

	chip.dev = &pdev->dev;
	chip.ops = &ops;
	chip.npwm = CHANNELS;
	err = devm_pwmchip_add(&pdev->dev, &chip);
	return err ? err : device_create_file(&pdev->dev, &dev_attr_state);
}

static struct platform_driver driver = {
	.driver = { .name = "datum-pwm" },
	.probe = probe,
};

static struct platform_device *device;

static int __init begin(void)
{
	int err = platform_driver_register(&driver);

	if (err)
		return err;
	device = platform_device_register_simple("datum-pwm", PLATFORM_DEVID_NONE, NULL, 0);
	return PTR_ERR_OR_ZERO(device);
}

static void __exit end(void)
{
	device_remove_file(&device->dev, &dev_attr_state);
	platform_device_unregister(device);
	platform_driver_unregister(&driver);
}

module_init(begin);
module_exit(end);
MODULE_LICENSE("GPL");
MODULE_DESCRIPTION("PWM chip without pins");
