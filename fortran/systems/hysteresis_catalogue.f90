! Optimize: -O1
!> Catalogue of hysteresis elements, by number.
module viscovib_hysteresis_catalogue
  use viscovib_bouc_wen_element, only: bouc_wen_element, new_bouc_wen
  use viscovib_dahl_element, only: dahl_element, new_dahl
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_jenkins_element, only: jenkins_element, new_jenkins
  use viscovib_kinds, only: wp
  use viscovib_user_elements, only: new_user_element
  implicit none
  private

  public :: new_hysteresis

  !> Values of `state` of a law term. User-defined elements have numbers above `state_user`.
  integer, parameter, public :: state_jenkins = 1, state_bouc_wen = 2, state_dahl = 3, &
                                state_user = 1000

contains

  !> Create an element from its parameters, in the order of its constructor.
  subroutine new_hysteresis(element, kind, numbers)
    class(hysteresis_type), allocatable, intent(out) :: element
    integer, intent(in) :: kind
    real(wp), intent(in) :: numbers(:)
    type(jenkins_element) :: jenkins
    type(bouc_wen_element) :: bouc_wen
    type(dahl_element) :: dahl

    select case (kind)
    case (state_bouc_wen)
      call new_bouc_wen(bouc_wen, numbers)
      allocate (element, source=bouc_wen)
    case (state_dahl)
      call new_dahl(dahl, numbers)
      allocate (element, source=dahl)
    case (state_jenkins)
      call new_jenkins(jenkins, numbers)
      allocate (element, source=jenkins)
    case default
      call new_user_element(element, kind - state_user, numbers)
    end select
  end subroutine new_hysteresis

end module viscovib_hysteresis_catalogue
