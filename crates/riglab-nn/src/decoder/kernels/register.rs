//! A register of numbers, as wide as the processor has them.

use std::arch::x86_64::*;

/// f32 numbers side by side.
///
/// # Safety
/// Of all functions: the processor has these registers, and what is pointed at is as long as one. They are inlined
/// whatever happens, so that the compiler meets their instructions in a function that may have them.
pub(super) trait Register: Copy {
    /// Numbers of one.
    const LANES: usize;

    unsafe fn all(x: f32) -> Self;
    unsafe fn load(from: *const f32) -> Self;
    unsafe fn store(self, to: *mut f32);
    unsafe fn add(self, other: Self) -> Self;
    unsafe fn mul(self, other: Self) -> Self;
    unsafe fn div(self, other: Self) -> Self;
    /// The larger ones; where either is no number, `other`.
    unsafe fn max(self, other: Self) -> Self;
    /// self · factor + more, rounded once.
    unsafe fn mul_add(self, factor: Self, more: Self) -> Self;
    /// To whole numbers.
    unsafe fn round(self) -> Self;
    /// self · 2^power, of whole powers from -126 to 127.
    unsafe fn scale(self, power: Self) -> Self;
    /// `then` where self is below zero, or -0.0 is.
    unsafe fn where_negative(self, then: Self, other: Self) -> Self;
    /// Zero where `x` is below `least`.
    unsafe fn unless_below(self, x: Self, least: Self) -> Self;
}

impl Register for __m256 {
    const LANES: usize = 8;

    #[inline(always)]
    unsafe fn all(x: f32) -> Self {
        unsafe { _mm256_set1_ps(x) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        unsafe { _mm256_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        unsafe { _mm256_storeu_ps(to, self) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        unsafe { _mm256_add_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        unsafe { _mm256_mul_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        unsafe { _mm256_div_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        unsafe { _mm256_max_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, more: Self) -> Self {
        unsafe { _mm256_fmadd_ps(self, factor, more) }
    }

    #[inline(always)]
    unsafe fn round(self) -> Self {
        unsafe { _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self) }
    }

    #[inline(always)]
    unsafe fn scale(self, power: Self) -> Self {
        unsafe {
            let power = _mm256_add_epi32(_mm256_cvtps_epi32(power), _mm256_set1_epi32(127));
            _mm256_mul_ps(self, _mm256_castsi256_ps(_mm256_slli_epi32::<23>(power)))
        }
    }

    #[inline(always)]
    unsafe fn where_negative(self, then: Self, other: Self) -> Self {
        unsafe { _mm256_blendv_ps(other, then, self) }
    }

    #[inline(always)]
    unsafe fn unless_below(self, x: Self, least: Self) -> Self {
        unsafe { _mm256_andnot_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(x, least), self) }
    }
}

impl Register for __m512 {
    const LANES: usize = 16;

    #[inline(always)]
    unsafe fn all(x: f32) -> Self {
        unsafe { _mm512_set1_ps(x) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        unsafe { _mm512_storeu_ps(to, self) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        unsafe { _mm512_add_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        unsafe { _mm512_mul_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        unsafe { _mm512_div_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        unsafe { _mm512_max_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, more: Self) -> Self {
        unsafe { _mm512_fmadd_ps(self, factor, more) }
    }

    #[inline(always)]
    unsafe fn round(self) -> Self {
        unsafe { _mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self) }
    }

    #[inline(always)]
    unsafe fn scale(self, power: Self) -> Self {
        unsafe { _mm512_scalef_ps(self, power) }
    }

    #[inline(always)]
    unsafe fn where_negative(self, then: Self, other: Self) -> Self {
        unsafe {
            let negative = _mm512_movepi32_mask(_mm512_castps_si512(self));
            _mm512_mask_blend_ps(negative, other, then)
        }
    }

    #[inline(always)]
    unsafe fn unless_below(self, x: Self, least: Self) -> Self {
        unsafe { _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_NLT_UQ>(x, least), self) }
    }
}
