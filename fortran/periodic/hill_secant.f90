! Optimize: -O3
!> One zero of Hill's determinant F by the secant method.
!!
!! At a motion nearby F may have had a slope and a bend there, F' and F''/(2 F') with all other
!! zeros divided out. With these the first step needs no second evaluation, and the next one knows
!! the slope at its end rather than amid the two.
module viscovib_hill_secant
  use viscovib_hill_determinant, only: gap_list, hill_determinant, into_strip, new_gaps
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: follow_exponent, local_shape, folded, secant

  !> Steps at most, and with the slope of a motion nearby. Steps that become no shorter may lead to
  !! a zero: along the exponential that F is far from there, past its extrema, and to close zeros.
  integer, parameter :: max_iterations = 30, few_iterations = 8
  !> In units of d: range of Re lambda, longest step, last step wanted and least, distance from a
  !! line of symmetry that counts as on it, distance of zeros that are the same.
  real(wp), parameter, public :: leftmost = -1.5_wp, smallest_step = 1.0e-13_wp
  real(wp), parameter, public :: on_line = 1.0e-7_wp
  real(wp), parameter :: rightmost = 45.0_wp, longest = 0.2_wp
  real(wp), parameter :: last_step = 1.0e-8_wp, same = 1.0e-9_wp
  !> Step to begin with, in d.
  real(wp), parameter, public :: first_step = 1.0e-4_wp
  complex(wp), parameter :: aside = 0.1_wp*first_step*(1.0_wp, 1.0_wp)
  !> In d: longest step by the slope of a motion nearby, how far from lines of symmetry such a zero
  !! must be if not on them, and steps that show how much the slope bends.
  real(wp), parameter :: longest_chord = 0.02_wp, clear = 0.02_wp, telling = 1.0e-6_wp
  !> A value that has grown by this factor over a step longer than this, in d, gives no slope: left
  !! of where memory ends F grows by any factor, and a step back by that slope is 0 wherever it
  !! begins.
  real(wp), parameter :: grown = 1.0e3_wp, long = 3.0e-5_wp
  !> The bend is what it was nearby up to this part.
  real(wp), parameter :: alike = 0.5_wp

  !> F near a zero with all others divided out, by lambda/d, at the motion before.
  type :: local_shape
    logical :: known = .false., about_half = .false., on_line = .false.
    !> F' and F''/(2 F'), 0: not known.
    complex(wp) :: slope = (0.0_wp, 0.0_wp), bend = (0.0_wp, 0.0_wp)
    integer :: n_multiplied = 0
  end type local_shape

contains

  !> Into 0 <= Im lambda <= d/2, on its borders where that may be.
  elemental complex(wp) function folded(lambda, d)
    complex(wp), intent(in) :: lambda
    real(wp), intent(in) :: d
    folded = into_strip(lambda, d)
    folded = cmplx(real(folded), abs(aimag(folded)), wp)
    if (aimag(folded) < on_line*d) folded = real(folded)
    if (aimag(folded) > (0.5_wp - on_line)*d) folded = cmplx(real(folded), 0.5_wp*d, wp)
  end function folded

  !> A zero, those known divided out.
  subroutine secant(hill, system, known, start, least, root, made, shape, sided)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: known(:), start
    !> Last step (d).
    real(wp), intent(in) :: least
    complex(wp), intent(out) :: root
    logical, intent(out) :: made
    !> What it was at a motion nearby, and is now.
    type(local_shape), intent(inout), optional :: shape
    !> Present: not made if its side of the axis cannot be determined.
    logical, intent(in), optional :: sided
    type(gap_list) :: gaps
    complex(wp) :: from, value
    logical :: about_half

    made = .false.
    call new_gaps(gaps, known, hill%period)
    ! All the way with the same orders: with others F has another scale.
    about_half = abs(aimag(start)) > 0.25_wp*hill%period
    if (present(shape)) then
      associate (place => near_line(shape, start, hill%period))
        if (may_follow(shape, place/hill%period, about_half, hill%n_without_memory)) then
          call reduced(hill, system, gaps, about_half, place, value)
          call iterate(hill, system, gaps, about_half, place, value, least, few_iterations, root, &
                       made, .true., shape, sided)
        end if
      end associate
    end if
    if (.not. made) then
      from = start
      ! At a zero that is divided out the value is lost in rounding error.
      if (any(abs(known - start) <= same*hill%period)) from = start + aside*hill%period
      call reduced(hill, system, gaps, about_half, from, value)
      call iterate(hill, system, gaps, about_half, from, value, least, max_iterations, root, &
                   made, .false., shape, sided)
    end if
    ! One of those known once more.
    if (made) made = all(abs(folded(known, hill%period) - folded(root, hill%period)) &
                         > same*hill%period)
    if (present(shape)) shape%known = shape%known .and. made
  end subroutine secant

  !> On a line of symmetry if the zero was there and may be still.
  pure complex(wp) function near_line(shape, start, d) result(place)
    type(local_shape), intent(in) :: shape
    complex(wp), intent(in) :: start
    real(wp), intent(in) :: d
    real(wp) :: y
    place = start
    if (.not. shape%on_line) return
    y = abs(aimag(folded(start, d)))
    if (y < clear*d) place = real(start)
    if (y > (0.5_wp - clear)*d) place = cmplx(real(start), 0.5_wp*d, wp)
  end function near_line

  !> Whether a slope is that of F near a start (d): on a line of symmetry all steps stay there.
  pure logical function may_follow(shape, start, about_half, n_multiplied)
    type(local_shape), intent(in) :: shape
    complex(wp), intent(in) :: start
    logical, intent(in) :: about_half
    integer, intent(in) :: n_multiplied
    real(wp) :: away
    away = min(abs(aimag(start)), abs(0.5_wp - abs(aimag(start))))
    may_follow = shape%known .and. (shape%about_half .eqv. about_half) &
                 .and. shape%n_multiplied == n_multiplied &
                 .and. (away > clear .or. .not. away > on_line)
  end function may_follow

  !> Steps from a start where F is known.
  subroutine iterate(hill, system, known, about_half, start, value_there, least, most, root, made, &
                     chord, shape, sided)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    type(gap_list), intent(in) :: known
    complex(wp), intent(in) :: start, value_there
    logical, intent(in) :: about_half
    real(wp), intent(in) :: least
    integer, intent(in) :: most
    complex(wp), intent(out) :: root
    logical, intent(out) :: made
    !> Whether to begin with the slope of a motion nearby.
    logical, intent(in) :: chord
    type(local_shape), intent(inout), optional :: shape
    logical, intent(in), optional :: sided
    complex(wp) :: before, value_before, value, step, slope, slope_before, older, bend, curvature
    real(wp) :: last, earlier, error, part, smallest, furthest
    integer :: i

    made = .false.
    associate (d => hill%period)
      if (chord) then
        step = -value_there/shape%slope*d
        root = start
        if (.not. abs(step) <= longest_chord*d) return
        root = start + step
        made = abs(step) <= least*d
        if (made) return
        before = start
        value_before = value_there
        last = abs(step)
        earlier = huge(earlier)
        call reduced(hill, system, known, about_half, root, value)
      else
        ! Off the real axis, or it would never be left.
        before = start + first_step*d*(1.0_wp, 1.0_wp)
        earlier = huge(earlier)
        last = huge(last)
        root = start
        value = value_there
        call reduced(hill, system, known, about_half, before, value_before)
      end if
      error = longest*d
      older = before
      slope_before = (0.0_wp, 0.0_wp)
      bend = slope_before
      curvature = bend
      smallest = abs(value_before)
      furthest = max(rightmost*d, 2.0_wp*real(start))
      do i = 1, most
        if (i > 1) call reduced(hill, system, known, about_half, root, value)
        if (.not. abs(value) <= huge(1.0_wp)) return
        if (abs(value) > grown*abs(value_before) .and. abs(root - before) > long*d) then
          root = before + 0.25_wp*(root - before)
          cycle
        end if
        if (.not. abs(value - value_before) > 0.0_wp) then
          made = i > 1
          exit
        end if
        slope = (value - value_before)/(root - before)
        if (i > 1) curvature = (slope - slope_before)/(slope*(root - older))*d
        if (i > 1 .and. last > telling*d) bend = curvature
        slope_before = slope
        older = before
        if (i == 1 .and. chord) slope = slope*(1.0_wp + shape%bend*(root - before)/d)
        step = -value/slope
        if (.not. abs(step) <= huge(1.0_wp)) return
        if (abs(step) > longest*d) step = step*(longest*d/abs(step))
        before = root
        value_before = value
        root = root + step
        if (real(root) < leftmost*d .or. real(root) > furthest) return
        ! The next step: the product of two steps and the bend, not after one back from a pole.
        error = abs(step)
        if (i == 1 .and. chord) then
          part = abs(shape%bend)/d*(alike*last + error)
          if (part > 0.0_wp) error = error*min(1.0_wp, part)
        else if (error < last .and. last < huge(last) .and. abs(value) < smallest) then
          error = error*min(1.0_wp, last/d*max(1.0_wp, abs(curvature)))
          if (last < earlier .and. earlier < huge(last)) error = min(error, abs(step)**2/earlier)
        end if
        smallest = min(smallest, abs(value))
        ! To rounding errors, or as far as zeros close to each other permit.
        made = error <= least*d .or. (abs(step) <= last_step*d .and. abs(step) >= last)
        if (made) exit
        earlier = last
        last = abs(step)
      end do
      ! Too close to the axis to be distinguished from it.
      if (present(sided) .and. error > least*d) made = made .and. abs(real(root)) > 3.0_wp*error
      if (made .and. present(shape)) then
        call note_shape(shape, hill, slope_before, bend, about_half, root)
      end if
    end associate
  end subroutine iterate

  !> F near a zero, for the next motion.
  pure subroutine note_shape(shape, hill, slope, bend, about_half, root)
    type(local_shape), intent(inout) :: shape
    class(hill_determinant), intent(in) :: hill
    complex(wp), intent(in) :: slope
    !> In d; 0: not known.
    complex(wp), intent(in) :: bend
    logical, intent(in) :: about_half
    complex(wp), intent(in) :: root
    real(wp) :: y

    y = aimag(folded(root, hill%period))
    shape%known = abs(slope) > 0.0_wp
    shape%about_half = about_half
    shape%on_line = .not. (abs(y) > 0.0_wp .and. abs(y) < 0.5_wp*hill%period)
    shape%slope = slope*hill%period
    if (abs(bend) > 0.0_wp) shape%bend = bend
    shape%n_multiplied = hill%n_without_memory
  end subroutine note_shape

  !> One exponent from the place it had at a motion nearby.
  subroutine follow_exponent(hill, system, start, exponent, made)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: start
    complex(wp), intent(out) :: exponent
    logical, intent(out) :: made
    complex(wp) :: none(0)

    made = .false.
    exponent = start
    if (hill%ready) call secant(hill, system, none, start, smallest_step, exponent, made)
    if (made) exponent = folded(exponent, hill%period)
  end subroutine follow_exponent

  !> F with the zeros that are known divided out.
  subroutine reduced(hill, system, known, about_half, lambda, value)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    type(gap_list), intent(in) :: known
    complex(wp), intent(in) :: lambda
    logical, intent(in) :: about_half
    complex(wp), intent(out) :: value

    call hill%determinant(system, lambda, value, about_half)
    call known%divide(lambda, value)
  end subroutine reduced

end module viscovib_hill_secant
