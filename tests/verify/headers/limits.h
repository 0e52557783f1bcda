/* SPDX-License-Identifier: MIT */
#define CHAR_BIT 8
#define INT_MAX 2147483647
#define UINT_MAX 4294967295u
