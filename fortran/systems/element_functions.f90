! Optimize: -O1
!> Force functions of engineering elements, which a law calls by name: odd functions of their first
!! operand, followed by constants.
!!
!!   stop(d, gap, exponent)                            (|d| - gap)^exponent beyond the gap
!!   relief(v, coefficient, exponent, limit, slope)    fluid damper with a relief valve
!!   stribeck(v, coulomb, static, velocity, exponent, width)
!!                                                     dry friction with a Stribeck curve
module viscovib_element_functions
  use viscovib_kinds, only: wp
  use viscovib_status, only: show
  implicit none
  private

  public :: element_function, read_constants

  !> Names of the functions, and largest number of constants.
  character(len=8), parameter, public :: element_functions(3) = ['stop    ', 'relief  ', 'stribeck']
  integer, parameter, public :: most_constants = 5

  !> Constants of a function: name, smallest and largest value, and default (below the smallest
  !! value: required). A smallest value of `above_0` means greater than 0.
  type :: constant_type
    character(len=11) :: name
    real(wp) :: least, most, default
  end type constant_type

  real(wp), parameter :: above_0 = tiny(1.0_wp), endless = huge(1.0_wp), none = -1.0_wp

contains

  pure subroutine list_constants(name, constants)
    character(len=*), intent(in) :: name
    type(constant_type), allocatable, intent(out) :: constants(:)
    select case (name)
    case ('stop')
      constants = [constant_type('gap', 0.0_wp, endless, none), &
                   constant_type('exponent', 1.0_wp, 20.0_wp, 1.0_wp)]
    case ('relief')
      constants = [constant_type('coefficient', above_0, endless, none), &
                   constant_type('exponent', 0.1_wp, 2.0_wp, none), &
                   constant_type('limit', above_0, endless, none), &
                   constant_type('slope', 0.0_wp, endless, 0.0_wp)]
    case default
      constants = [constant_type('coulomb', 0.0_wp, endless, none), &
                   constant_type('static', above_0, endless, none), &
                   constant_type('velocity', above_0, endless, none), &
                   constant_type('exponent', 0.5_wp, 4.0_wp, 1.0_wp), &
                   constant_type('width', 0.0_wp, endless, 0.0_wp)]
    end select
  end subroutine list_constants

  !> Check the constants of a function, and append defaults.
  pure subroutine read_constants(name, values, fault)
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(inout) :: values(:)
    !> Description of an error; empty: none.
    character(len=:), allocatable, intent(out) :: fault
    type(constant_type), allocatable :: constants(:)
    character(len=:), allocatable :: listed
    integer :: i, n

    fault = ''
    listed = ''
    call list_constants(name, constants)
    do i = 1, size(constants)
      listed = listed//', '//trim(constants(i)%name)
    end do
    n = size(values)
    do i = n + 1, size(constants)
      if (constants(i)%default >= constants(i)%least) values = [values, constants(i)%default]
    end do
    if (size(values) /= size(constants)) then
      fault = name//' has '//show(n)//' constants: must be '//name//'(u'//listed//')'
      return
    end if
    do i = 1, size(values)
      associate (one => constants(i))
        if (values(i) >= one%least .and. values(i) <= one%most) cycle
        fault = name//': '//trim(one%name)//' = '//show(values(i))//': must be '
        if (one%most < endless) then
          fault = fault//show(one%least)//' to '//show(one%most)
        else if (one%least > 0.0_wp) then
          fault = fault//'greater than 0'
        else
          fault = fault//'at least 0'
        end if
        return
      end associate
    end do
    if (name == 'stribeck') then
      if (values(2) < values(1)) fault = name//': static = '//show(values(2)) &
                                         //': must be at least coulomb, '//show(values(1))
    end if
  end subroutine read_constants

  !> The law of a function of u in its constants a, b, c, d, e.
  pure function element_function(name, constants) result(text)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: constants(:)
    character(len=:), allocatable :: text
    select case (name)
    case ('stop')
      text = 'max(u - a, 0)^b - max(-u - a, 0)^b'
    case ('relief')
      ! At exponent 1 the slope at rest is finite.
      text = 'a*sign(u)*abs(u)^b'
      if (abs(constants(2) - 1.0_wp) <= 0.0_wp) text = 'a*u'
      text = 'where(abs(u) < (c/a)^(1/b), '//text//', sign(u)*(c + d*(abs(u) - (c/a)^(1/b))))'
    case default
      text = '(a + (b - a)*exp(-abs(u/c)^d))*'
      if (constants(5) > 0.0_wp) then
        text = text//'tanh(u/e)'
      else
        text = text//'sign(u)'
      end if
    end select
  end function element_function

end module viscovib_element_functions
