!> Checks of the numbers of a body in space: an inertia that no body has, and numbers that are
!! probably not in SI units.
module viscovib_body_checks
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_mounted_body, only: mounted_body
  use viscovib_rounded, only: brief
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: check_inertia, doubt_units

  !> Relative rounding error of moments of inertia.
  real(wp), parameter :: no_inertia = 1.0e-9_wp
  !> Mounts farther away than this multiple of the radius of gyration are probably in mm; smallest
  !! radius of gyration (m) that may be wrong if it is far larger than the distances of mounts.
  real(wp), parameter :: far_away = 50.0_wp, large = 20.0_wp
  !> If the static deflection in the stiffest direction exceeds the size of the body, stiffnesses
  !! are probably in N/mm (machines sink by 1 to 30 mm, on soft air springs by 0.3 m), unless it
  !! exceeds this (m) even with 1000 times the stiffness.
  real(wp), parameter :: deepest = 0.1_wp, standard_gravity = 9.81_wp
  character(len=*), parameter :: nl = new_line('a')

contains

  !> Symmetric, with the principal moments of a body.
  subroutine check_inertia(inertia, status)
    real(wp), intent(in) :: inertia(3, 3)
    type(status_type), intent(out) :: status
    real(wp) :: moments(3), axes(3, 3)
    character(len=:), allocatable :: text

    call set_ok(status)
    if (maxval(abs(inertia - transpose(inertia))) > no_inertia*maxval(abs(inertia))) then
      call fail(status, status_input_error, 'inertia', 'inertia: must be symmetric')
      return
    end if
    call find_symmetric_modes(unit_matrix(), inertia, moments, axes)
    text = 'inertia: has the principal moments '//brief(moments(1))//', '//brief(moments(2))//', ' &
           //brief(moments(3))
    if (.not. moments(1) > 0.0_wp) then
      call fail(status, status_input_error, 'inertia', text//', must be greater than 0')
    else if (moments(3) > (moments(1) + moments(2))*(1.0_wp + no_inertia)) then
      call fail(status, status_input_error, 'inertia', text//'; no body has one that is larger ' &
                //'than the sum of the other two')
    end if
  end subroutine check_inertia

  !> A line for each number that is probably in other units; angles, and the first other one.
  function doubt_units(body, first, names, angles) result(text)
    type(mounted_body), intent(in) :: body
    !> First spring of each mount, its name, and its angles (rad), shape (3, n_mounts).
    integer, intent(in) :: first(:)
    character(len=*), intent(in) :: names(:)
    real(wp), intent(in) :: angles(:, :)
    character(len=:), allocatable :: text
    real(wp) :: radius, away, farthest, angle
    integer :: i

    text = ''
    radius = sqrt((body%inertia(1, 1) + body%inertia(2, 2) + body%inertia(3, 3)) &
                  /(2.0_wp*body%mass))
    farthest = 0.0_wp
    do i = 1, size(first)
      angle = angles(maxloc(abs(angles(:, i)), 1), i)
      if (abs(angle) > 2.0_wp*pi) then
        text = text//trim(names(i))//': angles: '//brief(angle)//' is more than a whole turn: ' &
               //'angles are in rad; multiply degrees by units.degree'//nl
      end if
      away = norm2(body%springs(first(i))%arm)
      farthest = max(farthest, away)
      if (away > far_away*radius) then
        text = text//trim(names(i))//': is '//brief(away)//' m from the centre of mass of a body ' &
               //'whose radius of gyration is '//brief(radius)//' m: positions are in m; ' &
               //'multiply values in mm by units.mm'//nl
        return
      end if
    end do
    if (radius > max(far_away*farthest, large) .and. farthest > 0.0_wp) then
      text = text//'inertia: the radius of gyration is '//brief(radius)//' m, the farthest mount ' &
             //'is '//brief(farthest)//' m from the centre of mass: inertia is in kg m^2; ' &
             //'multiply values in kg mm^2 by units.mm**2'//nl
    else
      text = text//doubt_stiffness(body, max(radius, farthest))
    end if
  end function doubt_units

  !> A line about springs so soft that the body would sink by more than its size. Springs with only
  !! a law carry it elsewhere than at rest, and a body of mass 1 may be dimensionless.
  function doubt_stiffness(body, extent) result(text)
    type(mounted_body), intent(in) :: body
    real(wp), intent(in) :: extent
    character(len=:), allocatable :: text
    real(wp) :: total(3, 3), largest(3), axes(3, 3), sunk
    logical :: has_law
    integer :: a, j

    text = ''
    if (abs(body%mass - 1.0_wp) <= 0.0_wp) return
    total = 0.0_wp
    do j = 1, size(body%springs)
      associate (spring => body%springs(j))
        has_law = size(spring%laws) + size(spring%coefficient) > 0
        if (has_law .and. .not. spring%stiffness > 0.0_wp) return
        if (spring%turning) cycle
        do a = 1, 3
          total(:, a) = total(:, a) + spring%stiffness*spring%direction(a)*spring%direction
        end do
      end associate
    end do
    call find_symmetric_modes(unit_matrix(), total, largest, axes)
    if (.not. largest(3) > 0.0_wp) return
    sunk = body%mass*standard_gravity/largest(3)
    if (.not. (sunk > extent .and. sunk < 1000.0_wp*deepest)) return
    text = 'stiffness: of all mounts together at most '//brief(largest(3))//' N/m in any ' &
           //'direction, by which '//brief(body%mass)//' kg would sink by '//brief(sunk)//' m, ' &
           //'more than the '//brief(extent)//' m that the body measures: stiffnesses are in ' &
           //'N/m; multiply values in N/mm by units.newton_per_mm'//nl
  end function doubt_stiffness

  pure function unit_matrix() result(unit)
    real(wp) :: unit(3, 3)
    integer :: i
    unit = 0.0_wp
    do i = 1, 3
      unit(i, i) = 1.0_wp
    end do
  end function unit_matrix

end module viscovib_body_checks
