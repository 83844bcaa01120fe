! Optimize: -O2
!> One zero of Hill's determinant of a condensed structure by the secant method.
!!
!! At a motion nearby F had a slope and a bend there, F' and F''/(2 F') with all other zeros divided
!! out. With these the first step needs no second evaluation, and the next one knows the slope at
!! its end rather than amid the two.
module viscovib_condensed_secant
  use viscovib_condensed_hill, only: condensed_hill
  use viscovib_condensed_poles, only: gap_list, into_strip, new_gaps
  use viscovib_kinds, only: wp
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: local_shape, folded, secant

  !> Steps at most, and with the slope of a motion nearby.
  integer, parameter :: max_iterations = 30, few_iterations = 8
  !> In units of d: range of Re lambda, longest step, last step wanted, distance from a line of
  !! symmetry that counts as on it, distance of zeros that are the same.
  real(wp), parameter :: leftmost = -1.5_wp, rightmost = 45.0_wp, longest = 0.2_wp
  real(wp), parameter :: last_step = 1.0e-7_wp, on_line = 1.0e-8_wp, same = 1.0e-8_wp
  !> Step to begin with, in d.
  real(wp), parameter, public :: first_step = 1.0e-4_wp
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
  subroutine secant(hill, system, known, start, least, root, made, shape)
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: known(:), start
    !> Last step (d).
    real(wp), intent(in) :: least
    complex(wp), intent(out) :: root
    logical, intent(out) :: made
    !> What it was at a motion nearby, and is now.
    type(local_shape), intent(inout), optional :: shape
    type(gap_list) :: gaps
    complex(wp) :: value
    logical :: about_half

    made = .false.
    call new_gaps(gaps, known, hill%period)
    ! All the way with the same orders: with others F has another scale.
    about_half = abs(aimag(start)) > 0.25_wp*hill%period
    if (present(shape)) then
      associate (place => near_line(shape, start, hill%period))
        if (may_follow(shape, place/hill%period, about_half, hill%poles%n_multiplied)) then
          call reduced(hill, system, gaps, about_half, place, value)
          call iterate(hill, system, gaps, about_half, place, value, least, few_iterations, root, &
                       made, shape, .true.)
        end if
      end associate
    end if
    if (.not. made) then
      call reduced(hill, system, gaps, about_half, start, value)
      call iterate(hill, system, gaps, about_half, start, value, least, max_iterations, root, &
                   made, shape, .false.)
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
                     shape, chord)
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    type(gap_list), intent(in) :: known
    complex(wp), intent(in) :: start, value_there
    logical, intent(in) :: about_half
    real(wp), intent(in) :: least
    integer, intent(in) :: most
    complex(wp), intent(out) :: root
    logical, intent(out) :: made
    type(local_shape), intent(inout), optional :: shape
    !> Whether to begin with the slope of a motion nearby.
    logical, intent(in) :: chord
    complex(wp) :: before, value_before, value, step, slope, slope_before, older, bend
    real(wp) :: last, earlier, error, smallest
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
        earlier = abs(before - start)
        last = huge(last)
        root = start
        value = value_there
        call reduced(hill, system, known, about_half, before, value_before)
      end if
      bend = (0.0_wp, 0.0_wp)
      smallest = abs(value_before)
      do i = 1, most
        if (i > 1) call reduced(hill, system, known, about_half, root, value)
        if (.not. abs(value) <= huge(1.0_wp)) return
        if (i > 1 .and. abs(value) > grown*abs(value_before) .and. abs(root - before) > long*d) then
          root = before + 0.25_wp*(root - before)
          cycle
        end if
        if (.not. abs(value - value_before) > 0.0_wp) then
          made = i > 1
          exit
        end if
        slope = (value - value_before)/(root - before)
        if (i > 1) then
          if (last > telling*d) bend = (slope - slope_before)/(slope*(root - older))*d
        end if
        slope_before = slope
        older = before
        ! At the root rather than amid the two.
        if (i == 1 .and. chord) slope = slope*(1.0_wp + shape%bend*(root - before)/d)
        step = -value/slope
        if (.not. abs(step) <= huge(1.0_wp)) return
        if (abs(step) > longest*d) step = step*(longest*d/abs(step))
        before = root
        value_before = value
        root = root + step
        if (real(root) < leftmost*d .or. real(root) > rightmost*d) return
        ! Steps go with the product of the two before: what the next one would be. A short one back
        ! from a pole is none of these.
        error = abs(step)
        if (i == 1 .and. chord) then
          if (abs(shape%bend) > 0.0_wp) then
            error = min(error, abs(shape%bend)/d*error*(alike*last + error))
          end if
        else if (i > 1 .and. error < last .and. last < earlier .and. abs(value) < smallest) then
          error = error*(error/earlier)
        end if
        smallest = min(smallest, abs(value))
        made = error <= least*d .or. (abs(step) <= last_step*d .and. abs(step) >= last)
        if (made) exit
        if (i > 1 .or. chord) earlier = last
        last = abs(step)
      end do
      if (.not. (made .and. present(shape))) return
      shape%known = abs(slope_before) > 0.0_wp
      shape%about_half = about_half
      associate (y => aimag(folded(root, d)))
        shape%on_line = .not. (abs(y) > 0.0_wp .and. abs(y) < 0.5_wp*d)
      end associate
      shape%slope = slope_before*d
      if (abs(bend) > 0.0_wp) shape%bend = bend
      shape%n_multiplied = hill%poles%n_multiplied
    end associate
  end subroutine iterate

  !> F with the zeros that are known divided out.
  subroutine reduced(hill, system, known, about_half, lambda, value)
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    type(gap_list), intent(in) :: known
    complex(wp), intent(in) :: lambda
    logical, intent(in) :: about_half
    complex(wp), intent(out) :: value

    call hill%determinant(system, lambda, value, about_half)
    call known%divide(lambda, value)
  end subroutine reduced

end module viscovib_condensed_secant
