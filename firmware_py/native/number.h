/* Numbers as text: nine significant digits, exactly like Python's format(value, ".9g"). */
#ifndef NUMBER_H
#define NUMBER_H

#include <stdint.h>
#include <string.h>

#define NUMBER_MAX 24 /* Bytes of the longest text. */

/* Write the text and return its length; 0 for numbers that this function leaves to Python.
 *
 * From 2^-13 to 2^29 the number is a binary fraction of few enough bits that its product with a
 * power of ten is an integer of 128 bits. So it is rounded exactly, ties to even. */
static int put_number(char *out, double value)
{
    static const uint64_t powers[] = {
        1, 10, 100, 1000, 10000, 100000, 1000000, 10000000, 100000000, 1000000000,
        UINT64_C(10000000000), UINT64_C(100000000000), UINT64_C(1000000000000),
    };
    uint64_t raw;
    char *to = out;
    memcpy(&raw, &value, sizeof raw);
    if (raw >> 63)
        *to++ = '-';
    raw &= UINT64_MAX >> 1;
    if (raw == 0) {
        *to++ = '0';
        return (int)(to - out);
    }
    int exponent = (int)(raw >> 52) - 1023;
    if (exponent < -13 || exponent > 28)
        return 0;
    unsigned __int128 whole = (raw & ((UINT64_C(1) << 52) - 1)) | UINT64_C(1) << 52;
    int shift = 52 - exponent;
    /* Exponent of the first digit: this value or one more; 1233 / 4096 is the logarithm of 2. */
    int first = (exponent * 1233) >> 12;
    if (whole * powers[8 - first] >> shift >= 1000000000)
        first++;
    unsigned __int128 product = whole * powers[8 - first];
    uint64_t digits = (uint64_t)(product >> shift);
    unsigned __int128 rest = product - ((unsigned __int128)digits << shift);
    unsigned __int128 half = (unsigned __int128)1 << (shift - 1);
    if (rest > half || (rest == half && digits & 1))
        digits++;
    if (digits == 1000000000) {
        digits = 100000000;
        first++;
    }
    char text[9];
    for (int at = 8; at >= 0; at--) {
        text[at] = (char)('0' + digits % 10);
        digits /= 10;
    }
    int count = 9, before = first + 1;
    while (text[count - 1] == '0')
        count--;
    if (before <= 0) {
        *to++ = '0';
        *to++ = '.';
        for (; before < 0; before++)
            *to++ = '0';
    } else {
        memcpy(to, text, (size_t)before);
        to += before;
        if (count > before)
            *to++ = '.';
    }
    if (count > before) {
        memcpy(to, text + before, (size_t)(count - before));
        to += count - before;
    }
    return (int)(to - out);
}

#endif
